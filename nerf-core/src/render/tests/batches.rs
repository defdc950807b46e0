//! Tests of batch sizes: with every batch, a frame has the same pixels and numbers of evaluations as a reference that
//! evaluates one sample at a time.

use super::*;
use crate::math::MathBackend;
use crate::sampling::Bins;
use crate::simd::BLOCK;
use crate::volume::Accumulator;

/// Reference for a frame, computed with one query per sample. Returns the pixels and the numbers of density and colour
/// evaluations.
fn sample_by_sample(
    renderer: &Renderer<'_>,
    quality: &Quality,
    camera: &Camera,
    size: (u32, u32),
) -> (Vec<Pixel>, u64, u64) {
    let bins = Bins::new(2.0, 6.0, 32).unwrap();
    let batch = Batch { rays: 50, samples: BLOCK };
    let plan = Plan::new(renderer.blob(), quality, Outputs::ALL, batch).unwrap();
    let mut memory = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let (mut pixels, mut densities, mut colours) = (vec![], 0, 0);
    for i in 0..size.0 * size.1 {
        let ray = camera.ray((i % size.0) as f32 + 0.5, (i / size.0) as f32 + 0.5);
        let mut gathered = Accumulator::NONE;
        for t in (0..32).map(|i| bins.at(i, 0.5)).filter(|&t| plan.occupied(ray.at(t))) {
            let (mut sigma, mut rgb) = ([f32::NAN], [[f32::NAN; 3]]);
            let dirs = [ray.dir.into()];
            renderer.query(&plan, &[ray.at(t).into()], &dirs, &mut memory, &mut sigma, &mut rgb).unwrap();
            densities += 1;
            gathered.add_density(MathBackend::Polynomial, sigma[0], t, bins.delta());
            if let Some(weight) = gathered.take_uncoloured(quality.colour_cut) {
                colours += 1;
                gathered.add_colour(weight, rgb[0]);
            }
            if gathered.transmittance() < quality.transmittance_cut {
                break;
            }
        }
        let is_cut = gathered.transmittance() < quality.transmittance_cut;
        let cosine = camera.z_per_distance(&ray);
        pixels.push(gathered.finish_from(0.0, is_cut, SCENE.background, 6.0, cosine));
    }
    (pixels, densities, colours)
}

#[test]
fn every_batch_gives_the_pixels_and_the_work_of_one_sample_at_a_time() {
    let a = every_kind();
    let (weights, unpacked) = halve(&parameters(&a, 31));
    let bits = [0b1110_1011];
    let bytes = bytes(&body(a, Some(StoredOccupancy { resolution: [2; 3], bits: &bits }), &weights));
    let blob = Blob::open(&bytes).unwrap();
    let camera = camera(9, 7);
    for kernel in kernels() {
        let renderer = Renderer::with_parameters(blob.clone(), kernel, &unpacked, None).unwrap();
        for (transmittance_cut, colour_cut) in [(0.0, 0.0), (1e-2, 1e-3), (0.0, 0.02), (0.3, 0.0), (0.3, 0.2)]
        {
            let quality =
                Quality { transmittance_cut, colour_cut, occupancy: colour_cut > 0.0, ..Quality::EXACT };
            let (pixels, densities, colours) = sample_by_sample(&renderer, &quality, &camera, (9, 7));
            assert!(pixels.iter().any(|pixel| pixel.opacity > 0.5) && colours > 0);
            for rays in [1, 2, 7, 63, 64, 256] {
                let batch = Batch { rays, samples: BLOCK };
                let plan = Plan::new(&blob, &quality, Outputs::ALL, batch).unwrap();
                let found = render(&renderer, &plan, &camera);
                assert_eq!(found.pixels, pixels, "{kernel:?} {quality:?} {rays} rays");
                let c = found.counters;
                assert_eq!((c.density_evaluations, c.colour_evaluations), (densities, colours));
                assert!(c.colour_evaluations <= c.density_evaluations);
            }
        }
    }
}

#[test]
fn weights_read_in_place_take_batches_of_any_size() {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 31));
    let bytes = bytes(&body(a, None, &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let camera = camera(9, 7);
    let quality = Quality { transmittance_cut: 0.05, colour_cut: 0.02, ..Quality::EXACT };
    let (pixels, densities, colours) = sample_by_sample(&renderer, &quality, &camera, (9, 7));
    for (rays, samples) in [(1, 1), (5, 1), (1, 7), (3, 2), (64, 5), (256, 63)] {
        let plan = Plan::new(&blob, &quality, Outputs::ALL, Batch { rays, samples }).unwrap();
        let found = render(&renderer, &plan, &camera);
        assert_eq!(found.pixels, pixels, "{rays} rays, {samples} samples");
        let c = found.counters;
        assert_eq!((c.density_evaluations, c.colour_evaluations), (densities, colours));
    }
}
