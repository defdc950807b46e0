//! Tests of frames of scenes whose position encoding is a learned grid.

use super::*;
use crate::blob::{Body, StoredTables};
use crate::encoding::{DirectionEncoding, GridEncoding, PositionEncoding, TableValues};
use crate::network::DensityActivation;
use crate::testing::{PICTURE, noise, picture_body, tolerance};

fn grid(inputs: u8, features: u8, log2_entries: u8, sides: &[u16]) -> GridEncoding {
    let z = |side| if inputs == 3 { side } else { 0 };
    let resolutions = sides.iter().map(|&side| [side, side, z(side)]).collect();
    GridEncoding { inputs, features, log2_entries, resolutions }
}

/// Architecture with a grid, spherical harmonics and an exponential density, the defaults of scenes.
fn shape(grid: GridEncoding) -> Architecture {
    Architecture {
        position: PositionEncoding::Grid(grid),
        direction: Some(DirectionEncoding::SphericalHarmonics { degree: 4 }),
        density: Some(DensityActivation::Exponential),
        ..architecture(pi(3, 0), None, &[(32, false)], &[32])
    }
}

fn stored(bytes: &[u8]) -> Option<StoredTables<'_>> {
    Some(StoredTables::F16(bytes))
}

struct Scene {
    file: Vec<u8>,
    parameters: Vec<f32>,
    tables: Vec<f32>,
}

fn scene(a: &Architecture, occupancy: Option<StoredOccupancy<'_>>, tables: &[f32]) -> Scene {
    let (weights, parameters) = halve(&parameters(a, 7));
    let (bytes_of_tables, tables) = halve(tables);
    let body = Body { tables: stored(&bytes_of_tables), ..body(a.clone(), occupancy, &weights) };
    Scene { file: bytes(&body), parameters, tables }
}

const ALL: Outputs =
    Outputs { median_distance: cfg!(feature = "median"), normals: cfg!(feature = "normals"), ..Outputs::ALL };

fn draw(file: &[u8], kernel: Kernel, outputs: Outputs, batch: Batch) -> Picture {
    let blob = Blob::open(file).unwrap();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
    let plan = Plan::new(&blob, &Quality::default(), outputs, batch).unwrap();
    render(&renderer, &plan, &camera(20, 13))
}

/// Scene whose tables are rounded to int8, with a scale of 1/8 at each level. Its `tables` hold the rounded values in
/// f32.
fn scene_in_int8(a: &Architecture, tables: &[f32]) -> Scene {
    let (weights, parameters) = halve(&parameters(a, 7));
    let steps: Vec<i8> = tables.iter().map(|&value| (value * 8.0).round() as i8).collect();
    let stored: Vec<u8> = steps.iter().map(|&step| step as u8).collect();
    let scales = 0.125f32.to_le_bytes().repeat(a.position.grid().unwrap().resolutions.len());
    let body = Body {
        tables: Some(StoredTables::Int8 { scales: &scales, bytes: &stored }),
        ..body(a.clone(), None, &weights)
    };
    let tables = steps.into_iter().map(|step| f32::from(step) * 0.125).collect();
    Scene { file: bytes(&body), parameters, tables }
}

fn bits(picture: &Picture) -> Vec<[u32; 9]> {
    let of = |p: &Pixel| {
        let ([r, g, b], [x, y, z]) = (p.rgb, p.normal);
        [r, g, b, x, y, z, p.opacity, p.ray_distance, p.z_depth].map(f32::to_bits)
    };
    picture.pixels.iter().map(of).collect()
}

#[test]
fn every_kernel_draws_the_same_scene_whatever_the_batch() {
    for features in [1, 2, 4] {
        let a = shape(grid(3, features, 9, &[4, 9, 20]));
        let values = noise(a.position.grid().unwrap().values(), 5);
        for scene in [scene(&a, None, &values), scene_in_int8(&a, &values)] {
            let expected = draw(&scene.file, Kernel::IN_PLACE, ALL, Batch::SMALLEST);
            assert!(expected.pixels.iter().any(|p| p.opacity > 0.5), "something to see");
            assert_eq!(expected.counters.invalid_samples, 0);
            for kernel in kernels() {
                let found = draw(&scene.file, kernel, ALL, Batch::FULL);
                let other = draw(&scene.file, kernel, ALL, Batch { rays: 3, samples: BLOCK });
                assert_eq!(bits(&found), bits(&other), "{kernel:?}, {features} features");
                if kernel == Kernel::IN_PLACE {
                    assert_eq!(bits(&found), bits(&expected));
                }
                let mut worst = 0.0f64;
                for (p, q) in found.pixels.iter().zip(&expected.pixels) {
                    for (a, b) in p.rgb.iter().zip(q.rgb) {
                        worst = worst.worse(f64::from((a - b).abs()));
                    }
                }
                assert!(worst <= tolerance(kernel, 1e-5) * 3.0, "{kernel:?}, {features} features: {worst:e}");
            }
        }
    }
}

/// Copy of the blob with entropy-coded int8 tables.
#[cfg(feature = "coded")]
fn coded(file: &[u8]) -> Vec<u8> {
    let blob = Blob::open(file).unwrap();
    let a = blob.architecture().clone();
    let Some(StoredTables::Int8 { scales, bytes: values }) = blob.tables() else { panic!("int8 tables") };
    let mut symbols = vec![[0; 2]; 2 * values.len()];
    let mut out = vec![0; 4 * values.len() + 4];
    let grid = a.position.grid().unwrap();
    let coded = crate::blob::encode_tables(grid, values, &mut symbols, &mut out).unwrap();
    let tables = Some(StoredTables::Coded { scales, bytes: coded });
    bytes(&Body { tables, ..body(a.clone(), None, blob.weights()) })
}

#[cfg(feature = "coded")]
#[test]
fn coded_tables_draw_the_bits_of_int8_in_memory_of_the_size_that_is_said() {
    for features in [1, 2, 4] {
        let a = shape(grid(3, features, 9, &[4, 9, 20]));
        let values = noise(a.position.grid().unwrap().values(), 5);
        let int8 = scene_in_int8(&a, &values).file;
        let file = coded(&int8);
        assert!(file.len() < int8.len(), "noise of 17 values");
        let (plain, blob) = (Blob::open(&int8).unwrap(), Blob::open(&file).unwrap());
        for kernel in kernels() {
            let expected = Renderer::prepared_lines(&blob, kernel);
            let decoded = a.position.grid().unwrap().values().div_ceil(64);
            assert_eq!(expected, Renderer::prepared_lines(&plain, kernel) + decoded);
            let found = expected - 1;
            let mut memory = vec![Line::UNINIT; found];
            let short = Renderer::new(blob.clone(), kernel, &mut memory).map(drop);
            assert_eq!(short, Err(RenderError::Memory { expected, found }));
            let pictures = [&int8, &file].map(|file| draw(file, kernel, ALL, Batch::FULL));
            assert_eq!(bits(&pictures[0]), bits(&pictures[1]), "{kernel:?}, {features} features");
        }
        #[cfg(feature = "std")]
        {
            let pixels = [int8, file].map(|file| {
                let scene = crate::Scene::from_bytes(file).unwrap();
                scene.render(&camera(20, 13)).unwrap().rgb8()
            });
            assert_eq!(pixels[0], pixels[1]);
        }
    }
}

#[test]
fn f32_tables_of_the_same_values_draw_the_same_picture() {
    let a = shape(grid(3, 2, 9, &[4, 9, 20]));
    let values = noise(a.position.grid().unwrap().values(), 5);
    for scene in [scene(&a, None, &values), scene_in_int8(&a, &values)] {
        let blob = Blob::open(&scene.file).unwrap();
        for kernel in kernels().filter(|kernel| !kernel.rounds()) {
            let tables =
                crate::encoding::GridTables::new(TableValues::F32(&scene.tables), blob.scene_box().as_ref());
            let plan = Plan::new(&blob, &Quality::EXACT, ALL, Batch::FULL).unwrap();
            let pictures = [
                Renderer::with_parameters(blob.clone(), kernel, &scene.parameters, None),
                Renderer::with_parameters(blob.clone(), kernel, &scene.parameters, Some(tables)),
            ]
            .map(|renderer| bits(&render(&renderer.unwrap(), &plan, &camera(20, 13))));
            assert_eq!(pictures[0], pictures[1], "{kernel:?}");
        }
        assert!(
            Renderer::with_parameters(
                blob.clone(),
                Kernel::IN_PLACE,
                &scene.parameters,
                Some(crate::encoding::GridTables::new(TableValues::F32(&scene.tables[1..]), None)),
            )
            .is_none()
        );
    }
}

#[test]
fn tables_of_f16_are_unpacked_in_webassembly_alone() {
    let a = shape(grid(3, 2, 16, &[4, 8]));
    let file = scene(&a, None, &noise(a.position.grid().unwrap().values(), 5)).file;
    let blob = Blob::open(&file).unwrap();
    for kernel in Kernel::all() {
        let [_, _, tables] = crate::render::renderer::Prepared::measure(&blob, kernel).unpacked;
        assert_eq!(tables > 0, kernel.isa == crate::Isa::Simd128, "{kernel}");
    }
}

#[test]
fn entries_that_no_occupied_cell_reads_change_nothing() {
    // Only the octant of the box with x, y and z below 0 is occupied.
    let a = shape(grid(3, 2, 16, &[4, 8]));
    let learned = a.position.grid().unwrap();
    let clean = noise(learned.values(), 5);
    let mut poisoned = clean.clone();
    for level in learned.levels() {
        let [nx, ny, _] = level.cells;
        for entry in 0..level.entries {
            let x = entry as u32 % (nx + 1);
            let y = entry as u32 / (nx + 1) % (ny + 1);
            let z = entry as u32 / (nx + 1) / (ny + 1);
            if [x, y, z].iter().any(|&v| 2 * v > nx) {
                let at = 2 * (level.first + entry);
                poisoned[at..at + 2].copy_from_slice(&[65_504.0, -65_504.0]);
            }
        }
    }
    let occupancy = || Some(StoredOccupancy { resolution: [2; 3], bits: &[1] });
    let (clean, poisoned) = (scene(&a, occupancy(), &clean), scene(&a, occupancy(), &poisoned));
    for kernel in kernels() {
        let [clean, poisoned] =
            [&clean, &poisoned].map(|scene| bits(&draw(&scene.file, kernel, ALL, Batch::FULL)));
        assert_eq!(clean, poisoned, "{kernel:?}");
    }
}

#[test]
fn a_picture_by_a_grid_is_the_network_at_its_pixels_with_every_kernel() {
    let a = Architecture {
        position: PositionEncoding::Grid(grid(2, 2, 6, &[3, 7, 30])),
        ..architecture(pi(2, 0), None, &[(16, false)], &[8])
    };
    let (weights, _) = halve(&parameters(&a, 2));
    let (tables, _) = halve(&noise(a.position.grid().unwrap().values(), 5));
    let bytes = bytes(&Body { tables: stored(&tables), ..picture_body(a, &weights) });
    let blob = Blob::open(&bytes).unwrap();
    let size = [PICTURE.width, PICTURE.height];
    let draw = |kernel, batch| {
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
        let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
        let mut workspace = vec![Line::UNINIT; renderer.picture_workspace_lines(batch)];
        let rect = Rect { x: 0, y: 0, width: size[0], height: size[1] };
        let mut found = vec![];
        let mut put = |_: u32, _: u32, rgb: [f32; 3]| found.push(rgb);
        let math = MathBackend::Polynomial;
        renderer.render_picture(math, batch, size, rect, &mut workspace, &mut put).unwrap();
        found
    };
    let expected = draw(Kernel::IN_PLACE, Batch::SMALLEST);
    let spread =
        expected.iter().map(|c| c[0]).fold(0.0, f32::max) - expected.iter().map(|c| c[0]).fold(1.0, f32::min);
    assert!(spread > 0.05, "something to see");
    for kernel in kernels() {
        for (found, expected) in draw(kernel, Batch::FULL).iter().zip(&expected) {
            let worst = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(f64::from(worst) <= tolerance(kernel, 2e-6), "{kernel:?}: {worst:e}");
        }
    }
}
