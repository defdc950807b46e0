//! Tests of deferred shading, compared with a reference renderer in f64. `h` is composited, and each ray is shaded
//! once.

use super::*;
use crate::blob::{Body, StoredTables};
use crate::encoding::{DirectionEncoding, GridEncoding, PositionEncoding};
use crate::network::{DensityActivation, Layer, Shading};
use crate::testing::{noise, tolerance};

mod oracle;
mod outputs;
#[cfg(feature = "instances")]
mod several;

use oracle::Oracle;

/// Architecture with a grid encoding and at most one trunk layer. `hidden`: width of the trunk layer, and whether it is
/// a skip layer; empty for no trunk layer. The composited `h` is the output of the trunk layer or, without one, the
/// encoding.
fn shape(hidden: &[(u16, bool)], density: DensityActivation) -> Architecture {
    let resolutions = [[4; 3], [7, 8, 9], [17; 3]].into_iter().collect();
    Architecture {
        position: PositionEncoding::Grid(GridEncoding {
            inputs: 3,
            features: 2,
            log2_entries: 9,
            resolutions,
        }),
        direction: Some(DirectionEncoding::SphericalHarmonics { degree: 3 }),
        density: Some(density),
        shading: Shading::PerRay,
        ..architecture(pi(3, 0), None, hidden, &[16])
    }
}

fn d11() -> Architecture {
    shape(&[], DensityActivation::Exponential)
}

fn d00() -> Architecture {
    shape(&[(20, false)], DensityActivation::ShiftedSoftplus)
}

/// A field with random parameters: its blob and its reference renderer.
struct Field {
    file: Vec<u8>,
    oracle: Oracle,
}

/// Makes a random field. The density layer's parameters are multiplied by `2 · thick`.
fn field(a: &Architecture, seed: u32, thick: f32, occupancy: Option<StoredOccupancy<'_>>) -> Field {
    let mut all = parameters(a, seed);
    for layer in a.layers().iter().filter(|layer| layer.role == Role::Density) {
        all[layer.weights..layer.bias + 1].iter_mut().for_each(|x| *x *= 2.0 * thick);
    }
    let (weights, all) = halve(&all);
    let (bytes_of_tables, tables) = halve(&noise(a.position.grid().unwrap().values(), seed + 1));
    let tables_stored = Some(StoredTables::F16(&bytes_of_tables));
    let file = bytes(&Body { tables: tables_stored, ..body(a.clone(), occupancy, &weights) });
    Field { file, oracle: Oracle { shape: a.clone(), parameters: all, tables } }
}

fn with<T>(file: &[u8], kernel: Kernel, use_it: impl FnOnce(&Blob<'_>, &Renderer<'_>) -> T) -> T {
    let blob = Blob::open(file).unwrap();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
    use_it(&blob, &renderer)
}

fn draw(file: &[u8], kernel: Kernel, quality: &Quality, outputs: Outputs, batch: Batch) -> Picture {
    with(file, kernel, |blob, renderer| {
        render(renderer, &Plan::new(blob, quality, outputs, batch).unwrap(), &camera(20, 13))
    })
}

const ALL: Outputs =
    Outputs { median_distance: cfg!(feature = "median"), normals: cfg!(feature = "normals"), ..Outputs::ALL };

/// Largest difference of colour or opacity between two images.
fn worst<'p>(found: &[Pixel], expected: impl Iterator<Item = &'p ([f64; 3], f64)>) -> f64 {
    let of = |(p, (rgb, opacity)): (&Pixel, &([f64; 3], f64))| {
        let colours = p.rgb.iter().zip(rgb).map(|(a, b)| (f64::from(*a) - b).abs());
        colours.fold((f64::from(p.opacity) - opacity).abs(), Worse::worse)
    };
    found.iter().zip(expected).map(of).fold(0.0, Worse::worse)
}

fn rays(width: u32, height: u32) -> impl Iterator<Item = crate::camera::Ray> {
    let camera = camera(width, height);
    (0..width * height).map(move |i| camera.ray((i % width) as f32 + 0.5, (i / width) as f32 + 0.5))
}

#[test]
fn a_frame_is_that_of_the_slow_renderer_with_every_kernel() {
    let cuts = Quality { transmittance_cut: 0.05, colour_cut: 0.03, ..Quality::EXACT };
    for a in [d11(), d00()] {
        let Field { file, oracle } = field(&a, 3, 1.0, None);
        for quality in [Quality::EXACT, cuts] {
            let expected: Vec<_> = rays(20, 13).map(|ray| oracle.pixel(&ray, &quality)).collect();
            let seen = expected.iter().filter(|(_, opacity)| *opacity > 0.2).count();
            let spread = expected.iter().map(|(rgb, _)| rgb[0]).fold(0.0, f64::max);
            assert!(seen > 50 && spread > 0.3, "something to see: {seen}, {spread}");
            // With cuts, kernels that round weights are left out: a rounded density may end a ray at another sample.
            for kernel in kernels().filter(|kernel| quality == Quality::EXACT || !kernel.rounds()) {
                let found = draw(&file, kernel, &quality, Outputs::ALL, Batch::FULL);
                let off = worst(&found.pixels, expected.iter());
                std::println!("{kernel:?}, {} layers: {off:e}", a.trunk.len());
                assert!(off <= tolerance(kernel, 5e-6) * 4.0, "{kernel:?}: {off:e}");
                assert_eq!(found.counters.invalid_samples, 0);
            }
        }
    }
}

#[test]
fn the_same_bits_in_every_batch_tile_and_call() {
    let bits = |p: &Pixel| {
        let ([r, g, b], [x, y, z]) = (p.rgb, p.normal);
        [r, g, b, x, y, z, p.opacity, p.ray_distance, p.z_depth, p.median_distance].map(f32::to_bits)
    };
    for a in [d11(), d00()] {
        let occupancy = StoredOccupancy { resolution: [2; 3], bits: &[0b1101_0111] };
        let Field { file, .. } = field(&a, 4, 1.0, Some(occupancy));
        for (kernel, quality) in kernels()
            .flat_map(|k| [(k, Quality::default()), (k, Quality { occupancy: true, ..Quality::EXACT })])
        {
            let draw = |batch| {
                let found = draw(&file, kernel, &quality, ALL, batch);
                (found.pixels.iter().map(bits).collect::<Vec<_>>(), found.counters)
            };
            let expected = draw(Batch::FULL);
            assert!(expected.1.colour_evaluations > 20, "{:?}", expected.1);
            for batch in
                [Batch::SMALLEST, Batch { rays: 3, samples: BLOCK }, Batch { rays: 100, samples: 17 }]
            {
                assert_eq!(draw(batch), expected, "{kernel:?}, {batch:?}");
            }
            with(&file, kernel, |blob, renderer| {
                let plan = Plan::new(blob, &quality, ALL, Batch::FULL).unwrap();
                let mut memory = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
                let mut worker = renderer.worker(&plan, &mut memory).unwrap();
                let forward = camera(20, 13).pose().forward();
                for (ray, expected) in rays(20, 13).zip(&expected.0) {
                    let alone = &mut |_: usize, pixel: &Pixel| assert_eq!(bits(pixel), *expected);
                    worker.render_rays(&[ray.into()], Some(forward), alone).unwrap();
                }
            });
        }
    }
}

#[test]
fn the_work_is_a_density_a_sample_and_a_network_a_ray() {
    for a in [d11(), d00()] {
        let Field { file, oracle } = field(&a, 5, 1.0, None);
        let lit = rays(20, 13).filter(|ray| oracle.pixel(ray, &Quality::EXACT).1 > 0.0).count() as u64;
        for batch in [Batch::SMALLEST, Batch::FULL] {
            let draw = |outputs| draw(&file, Kernel::IN_PLACE, &Quality::EXACT, outputs, batch).counters;
            let (colour, depth) = (draw(Outputs::ALL), draw(Outputs { rgb: false, ..Outputs::ALL }));
            assert_eq!(colour.colour_evaluations, lit);
            let macs = [a.density_macs(), a.colour_macs()].map(|macs| macs as u64);
            assert_eq!(colour.macs, colour.density_evaluations * macs[0] + lit * macs[1]);
            // Without colour, only the density is evaluated.
            assert_eq!(depth.colour_evaluations, 0);
            assert_eq!(depth.macs, colour.density_evaluations * macs[0]);
        }
    }
    assert_eq!((d11().density_macs(), d11().gradient_macs()), (6, 0));
}

#[test]
fn a_colour_that_is_no_number_is_black_and_counted_once_a_ray() {
    let a = d11();
    let mut all = parameters(&a, 5);
    // Very large biases in the first colour layer, with which colours are still finite.
    let layers = a.layers();
    let hidden = layers.iter().find(|layer| matches!(layer.role, Role::Colour(0))).unwrap();
    all[hidden.bias..hidden.bias + 2].fill(65_504.0);
    let (weights, _) = halve(&all);
    let grid = a.position.grid().unwrap().clone();
    let (tables, _) = halve(&noise(grid.values(), 9));
    let file = bytes(&Body { tables: Some(StoredTables::F16(&tables)), ..body(a, None, &weights) });
    with(&file, Kernel::IN_PLACE, |blob, renderer| {
        let plan = Plan::new(blob, &Quality::EXACT, Outputs::ALL, Batch::FULL).unwrap();
        let sane = render(renderer, &plan, &camera(6, 5));
        assert_eq!(sane.counters.invalid_samples, 0, "{:?}", sane.counters);
    });
    let mut poisoned = weights.clone();
    poisoned[2 * hidden.bias..][..2].copy_from_slice(&0x7e00u16.to_le_bytes());
    let blob = Blob::open(&file).unwrap().with_weights(&poisoned);
    // Unpacked: weights that are read in place are finite, as `Blob::open` ensures.
    let kernel = Kernel::by_name("portable").unwrap();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).unwrap();
    let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::FULL).unwrap();
    let plan = plan.with_background([0.0; 3]).unwrap();
    let found = render(&renderer, &plan, &camera(6, 5));
    assert!(found.pixels.iter().all(|pixel| pixel.rgb == [0.0; 3]));
    assert!(found.counters.colour_evaluations > 5);
    assert_eq!(found.counters.invalid_samples, found.counters.colour_evaluations);
}
