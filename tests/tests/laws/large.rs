//! Limits of the file format: 4,096 samples per ray and 16 layers of 512 units work with every kernel; anything larger
//! is refused.

use crate::blob_damage::fix_checksum;
use nerf_core::Kernel;
use nerf_core::blob::{Blob, BlobError, HEADER_LEN, MAX_SAMPLES, Section};
use nerf_core::camera::Camera;
use nerf_core::memory::Line;
use nerf_core::network::{ArchitectureError, MAX_TRUNK, MAX_WIDTH};
use nerf_core::plan::{Batch, Outputs, Plan, PlanError, Quality};
use nerf_core::render::{Rect, RenderError, Renderer};
use nerf_core::sampling::Bins;
use nerf_core::volume::Pixel;
use nerf_testing::error::worst_of;
use nerf_testing::fence::{Fenced, Flush};
use nerf_testing::oracle::network::{Network, f16};
use nerf_testing::oracle::{sampling, volume};
use nerf_testing::scenes::{Recipe, camera, kernels};
use nerf_testing::tools;

/// Colour and opacity of a pixel: r, g, b, opacity.
type Found = [f32; 4];

/// Renders an image with every kernel and `samples` samples per ray, in memory of exactly the required sizes. Verifies
/// that one line less is refused.
fn pictures(bytes: &[u8], samples: u16, camera: &Camera) -> Vec<(Kernel, Vec<Found>)> {
    let blob = Blob::open(bytes).expect("a blob");
    let quality = Quality { samples, ..Quality::EXACT };
    let draw = |kernel: Kernel| {
        let plan = Plan::new(&blob, &quality, Outputs::ALL, Batch::FULL).expect("a plan");
        let lines = Renderer::prepared_lines(&blob, kernel);
        if let Some(less) = lines.checked_sub(1) {
            let refused = Renderer::new(blob.clone(), kernel, &mut vec![Line::UNINIT; less]).map(|_| ());
            assert_eq!(refused, Err(RenderError::Memory { expected: lines, found: less }));
        }
        let mut memory = Fenced::filled(lines, Line::UNINIT, Flush::End);
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
        let lines = renderer.workspace_lines(&plan);
        let mut workspace = Fenced::filled(lines, Line::UNINIT, Flush::End);
        let i = camera.intrinsics();
        let mut picture = vec![[f32::NAN; 4]; (i.width * i.height) as usize];
        let mut put = |x: u32, y: u32, p: &Pixel| {
            picture[(y * i.width + x) as usize] = [p.rgb[0], p.rgb[1], p.rgb[2], p.opacity];
        };
        let rect = Rect::full(camera);
        let refused = renderer.render(&plan, camera, rect, &mut workspace[1..], &mut put);
        assert_eq!(refused, Err(RenderError::Memory { expected: lines, found: lines - 1 }));
        let work = renderer.render(&plan, camera, rect, &mut workspace, &mut put).expect("a picture");
        let all = u64::from(i.width * i.height) * u64::from(samples);
        assert_eq!(work.samples_kept + work.samples_skipped, all, "{kernel:?}");
        assert!(work.samples_kept > all / 8, "{kernel:?}: {work:?} proves little");
        (kernel, picture)
    };
    kernels().map(draw).collect()
}

/// Returns the f64 oracle's result for a pixel. The oracle evaluates the camera's ray at the sample points that f32
/// arithmetic gives.
fn oracle(bytes: &[u8], samples: u16, camera: &Camera, x: u32, y: u32) -> [f64; 4] {
    let blob = Blob::open(bytes).expect("a blob");
    let scene = blob.scene().expect("a scene");
    let weights: Vec<f64> =
        blob.weights().chunks_exact(2).map(|b| f16(u16::from_le_bytes([b[0], b[1]]))).collect();
    let network = Network::of_file(blob.architecture(), &weights);
    let bins = Bins::new(scene.near, scene.far, samples.into()).expect("bins");
    let t = sampling::middles(scene.near.into(), scene.far.into(), samples.into());
    let ray = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
    let dir = ray.dir.to_array().map(f64::from);
    let (mut sigma, mut rgb) = (Vec::new(), Vec::new());
    for (i, &t) in t.iter().enumerate() {
        let middle = bins.at(i as u32, 0.5);
        // Two roundings of numbers that are at most `far`.
        assert!((f64::from(middle) - t).abs() <= f64::from(scene.far * f32::EPSILON), "{middle}, {t}");
        let point = ray.at(middle).to_array().map(f64::from);
        let inside = (0..3).all(|c| point[c] >= scene.min[c].into() && point[c] <= scene.max[c].into());
        sigma.push(if inside { network.sigma(&point) } else { 0.0 });
        rgb.push(if inside { network.rgb(&point, &dir) } else { [0.0; 3] });
    }
    let delta = f64::from(scene.far - scene.near) / f64::from(samples);
    let pixel =
        volume::composite(&sigma, &rgb, &t, &vec![delta; samples.into()], scene.background.map(f64::from));
    [pixel.rgb[0], pixel.rgb[1], pixel.rgb[2], pixel.opacity]
}

/// Compares the images of every kernel with the portable kernel's image and, at `pixels`, with the oracle.
fn compare(
    bytes: &[u8],
    samples: u16,
    camera: &Camera,
    pixels: &[(u32, u32)],
    f32_bound: f64,
    bf16_bound: f64,
) {
    let found = pictures(bytes, samples, camera);
    let (_, portable) = &found[0];
    let different: std::collections::BTreeSet<_> = portable.iter().map(|p| p[3].to_bits()).collect();
    assert!(different.len() > portable.len() / 2, "a flat picture proves nothing");
    let truth: Vec<_> = pixels.iter().map(|&(x, y)| oracle(bytes, samples, camera, x, y)).collect();
    for (kernel, picture) in &found {
        // A picture starts as NaNs.
        assert!(
            picture.iter().flatten().all(|x| x.is_finite()),
            "{kernel:?}: a pixel is missing or no number"
        );
        let bound = if kernel.rounds() { bf16_bound } else { f32_bound };
        let errors = picture.iter().flatten().zip(portable.iter().flatten());
        let apart = worst_of(errors.map(|(a, b)| f64::from((a - b).abs())));
        let at = |&(x, y): &(u32, u32)| picture[(y * camera.intrinsics().width + x) as usize];
        let errors = pixels.iter().map(at).zip(&truth);
        let errors = errors.flat_map(|(a, b)| (0..4).map(move |c| (f64::from(a[c]) - b[c]).abs()));
        let off = worst_of(errors);
        println!("{}: {apart:.1e} from portable instructions, {off:.1e} from the oracle", kernel);
        assert!(apart <= bound && off <= bound, "{kernel:?}: {apart}, {off}, bound {bound}");
    }
}

#[test]
fn rays_of_4096_samples_are_the_oracle_s_with_every_kernel() {
    let bytes = Recipe::SKIP.blob();
    let camera = camera(4, 3);
    let pixels: Vec<_> = (0..12).map(|i| (i % 4, i / 4)).collect();
    // Up to nine times what was seen, 6.4e-8 and 2.4e-3: what samples err by, with either sign, cancels.
    compare(&bytes, MAX_SAMPLES, &camera, &pixels, 6e-7, 2e-2);
    let blob = Blob::open(&bytes).expect("a blob");
    let quality = Quality { samples: MAX_SAMPLES + 1, ..Quality::EXACT };
    let refused = Plan::new(&blob, &quality, Outputs::ALL, Batch::SMALLEST).map(|_| ());
    assert_eq!(refused, Err(PlanError::Samples { found: 4097 }));
    assert_eq!(
        refused.map_err(|error| error.to_string()),
        Err("quality.samples: expected at most 4096 a ray, found 4097".into())
    );
}

/// Scene of 16 layers of 512 units, the last of which also takes the encoded position.
const LARGEST: Recipe =
    Recipe { trunk: (MAX_TRUNK, MAX_WIDTH as u16), skip: true, seed: 31, ..Recipe::PLAIN };

#[test]
fn sixteen_layers_of_512_are_the_oracle_s_with_every_kernel() {
    let bytes = LARGEST.blob();
    // About seven times what was seen between two kernels, 3.1e-6 and 1.4e-2: sums of 512 in another order, 16 deep.
    compare(&bytes, 8, &camera(3, 2), &[(0, 0), (1, 1)], 2e-5, 1e-1);
    if tools::long() {
        // Both at once: 4,096 samples of the largest network, whose errors cancel. Eight times 1.2e-7 and 1.7e-3.
        compare(&bytes, MAX_SAMPLES, &camera(2, 1), &[(0, 0)], 1e-6, 1.4e-2);
    }
}

#[test]
fn a_layer_more_and_a_unit_more_than_the_format_allows_are_refused() {
    let bytes = LARGEST.blob();
    // The trunk in the file: the number of its layers, and of each its width as a varint and its skip.
    let first = [16, 0x80, 0x04, 0, 0x80, 0x04, 0];
    let at = bytes.windows(first.len()).position(|window| window == first).expect("the trunk");
    let open = |bytes: &mut Vec<u8>| {
        let length = (bytes.len() - HEADER_LEN) as u64;
        bytes[16..24].copy_from_slice(&length.to_le_bytes());
        fix_checksum(bytes);
        Blob::open(bytes).map(|_| ())
    };
    let mut same = bytes.clone();
    assert_eq!(open(&mut same), Ok(()));
    let mut wide = bytes.clone();
    wide[at + 4] = 0x81;
    let refused = ArchitectureError::Width { field: "trunk", index: 1, found: 513 };
    assert_eq!(open(&mut wide), Err(BlobError::Architecture(refused)));
    assert_eq!(refused.to_string(), "trunk layer 1: expected a width of 1 to 512, found 513");
    let mut deep = bytes;
    deep[at] = 17;
    deep.splice(at + 1..at + 1, [0x80, 0x04, 0]);
    assert_eq!(open(&mut deep), Err(BlobError::Body(Section::Architecture)));
}
