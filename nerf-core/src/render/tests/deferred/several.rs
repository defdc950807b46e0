//! Tests of several fields in one frame, some of them with deferred shading.

use super::oracle::pixel_of;
use super::*;
use crate::render::{Instance, Worker};
use crate::space::Placement;

const EVERYWHERE: Quality = Quality::EXACT;

fn with_instances<T>(
    files: &[&[u8]],
    kernel: Kernel,
    batch: Batch,
    use_it: impl FnOnce(&mut Worker<'_>) -> T,
) -> T {
    let blobs: Vec<_> = files.iter().map(|file| Blob::open(file).unwrap()).collect();
    let plans: Vec<_> = blobs.iter().map(|blob| Plan::new(blob, &EVERYWHERE, ALL, batch).unwrap()).collect();
    let mut memory: Vec<_> =
        blobs.iter().map(|blob| vec![Line::UNINIT; Renderer::prepared_lines(blob, kernel)]).collect();
    let prepared = blobs.iter().zip(&mut memory);
    let renderers: Vec<_> =
        prepared.map(|(blob, memory)| Renderer::new(blob.clone(), kernel, memory).unwrap()).collect();
    let of = |(renderer, plan)| Instance { renderer, plan, placement: Placement::IDENTITY };
    let instances: Vec<_> = renderers.iter().zip(&plans).map(of).collect();
    let lines = Worker::instances_lines(renderers.iter(), plans.last().unwrap());
    let mut memory = vec![Line::UNINIT; lines];
    use_it(&mut Worker::of_instances(&instances, &mut memory).unwrap())
}

fn draw_all(files: &[&[u8]], kernel: Kernel, batch: Batch) -> Picture {
    let camera = camera(20, 13);
    let mut pixels = vec![Pixel::BLANK; 260];
    let mut put = |x: u32, y: u32, pixel: &Pixel| pixels[(20 * y + x) as usize] = *pixel;
    let counters = with_instances(files, kernel, batch, |worker| {
        worker.render(&camera, Rect::full(&camera), &mut put).unwrap()
    });
    Picture { pixels, counters }
}

#[test]
fn one_instance_is_the_field() {
    for a in [d11(), d00()] {
        let Field { file, oracle } = field(&a, 3, 1.0, None);
        let expected: Vec<_> = rays(20, 13).map(|ray| oracle.pixel(&ray, &EVERYWHERE)).collect();
        for kernel in kernels() {
            let found = draw_all(&[&file], kernel, Batch::FULL);
            let off = worst(&found.pixels, expected.iter());
            assert!(off <= tolerance(kernel, 5e-6) * 4.0, "{kernel:?}: {off:e}");
            let lit = expected.iter().filter(|(_, opacity)| *opacity > 0.0).count() as u64;
            assert_eq!(found.counters.colour_evaluations, lit);
        }
    }
}

#[test]
fn overlapping_fields_have_a_network_each_and_share_the_weights_by_density() {
    let (a, b) = (field(&d11(), 3, 1.0, None), field(&d00(), 8, 0.5, None));
    let expected: Vec<_> =
        rays(20, 13).map(|ray| pixel_of(&[&a.oracle, &b.oracle], &ray, &EVERYWHERE)).collect();
    for kernel in kernels() {
        let found = draw_all(&[&a.file, &b.file], kernel, Batch::FULL);
        let off = worst(&found.pixels, expected.iter());
        assert!(off <= tolerance(kernel, 5e-6) * 4.0, "{kernel:?}: {off:e}");
        let other = draw_all(&[&a.file, &b.file], kernel, Batch { rays: 7, samples: BLOCK });
        assert_eq!((&found.pixels, found.counters), (&other.pixels, other.counters), "{kernel:?}");
    }
}

#[test]
fn two_instances_of_a_field_in_one_place_are_that_field_of_twice_the_density() {
    let a = shape(&[(20, false)], DensityActivation::Relu);
    let (once, twice) = (field(&a, 3, 1.0, None), field(&a, 3, 2.0, None));
    for kernel in kernels() {
        let both = draw_all(&[&once.file, &once.file], kernel, Batch::FULL);
        let one = draw_all(&[&twice.file], kernel, Batch::FULL);
        let close = |a: &Pixel, b: &Pixel| a.rgb.iter().zip(b.rgb).all(|(a, b)| (a - b).abs() < 2e-5);
        assert!(both.pixels.iter().zip(&one.pixels).all(|(a, b)| close(a, b)), "{kernel:?}");
        assert!(both.pixels.iter().any(|pixel| pixel.opacity > 0.5));
    }
}

/// A frame may have fields with and without deferred shading. Fog of one colour looks the same with either.
#[test]
fn fields_shaded_at_samples_mix_with_those_shaded_once_a_ray() {
    let fog = |shading| {
        let a = Architecture { shading, ..d00() };
        let (weights, all) = halve(&constant(&a, 1.2, [2.0, -1.0, 0.5]));
        let (tables, values) = halve(&noise(a.position.grid().unwrap().values(), 9));
        let tables = Some(StoredTables::F16(&tables));
        let file = bytes(&Body { tables, ..body(a.clone(), None, &weights) });
        Field { file, oracle: Oracle { shape: a, parameters: all, tables: values } }
    };
    let (a, b) = (field(&d11(), 3, 0.5, None), fog(Shading::PerSample));
    let expected: Vec<_> =
        rays(20, 13).map(|ray| pixel_of(&[&a.oracle, &b.oracle], &ray, &EVERYWHERE)).collect();
    for kernel in kernels() {
        for files in [[&a.file, &b.file], [&b.file, &a.file], [&a.file, &fog(Shading::PerRay).file]] {
            let found = draw_all(&files.map(|file| &file[..]), kernel, Batch::FULL);
            let off = worst(&found.pixels, expected.iter());
            assert!(off <= tolerance(kernel, 5e-6) * 4.0, "{kernel:?}: {off:e}");
        }
    }
}

#[test]
fn points_of_several_fields_have_the_mean_of_their_networks_by_density() {
    let (a, b) = (field(&d11(), 3, 1.0, None), field(&d00(), 8, 0.5, None));
    let (p, dir) = ([0.3, -0.4, 0.2], Vec3::new(0.6, 0.0, -0.8));
    for kernel in kernels() {
        let (mut sigma, mut rgb) = ([0.0], [[0.0; 3]]);
        with_instances(&[&a.file, &b.file], kernel, Batch::FULL, |worker| {
            worker.query(&[p], &[dir.into()], &mut sigma, &mut rgb).unwrap();
        });
        let [own, other] = [&a.oracle, &b.oracle].map(|oracle| {
            let (h, raw) = oracle.at(p.map(f64::from));
            (oracle.sigma(raw), oracle.network(&h, dir))
        });
        let total = own.0 + other.0;
        let mut off = (f64::from(sigma[0]) - total).abs() / total;
        for (found, (a, b)) in rgb[0].into_iter().zip(own.1.into_iter().zip(other.1)) {
            let mean = (own.0 * a + other.0 * b) / total;
            off = (f64::from(found) - mean).abs().worse(off);
        }
        assert!(off <= tolerance(kernel, 5e-6) * 4.0, "{kernel:?}: {off:e}");
    }
}

/// Where two fields overlap, the colour of a collision is the mean of the fields' colours at the sample, weighted by
/// density.
#[test]
fn collisions_of_several_fields_mix_their_samples_networks() {
    let (a, b) = (field(&d11(), 3, 0.3, None), field(&d00(), 8, 0.2, None));
    let kernel = Kernel::IN_PLACE;
    let mut seen = 0;
    for ray in rays(6, 5) {
        let samples = [&a.oracle, &b.oracle].map(|oracle| {
            let own = |s: &oracle::Sample| (s.t, s.sigma, oracle.network(&s.h, ray.dir));
            oracle.samples(&ray).iter().map(own).collect::<Vec<_>>()
        });
        let random: Vec<f32> = (0..20).map(|i| (i as f32 + 0.5) / 20.0).collect();
        let mut put = |_: usize, pixel: &Pixel| {
            let near = |s: &(f64, f64, [f64; 3])| (s.0 - f64::from(pixel.ray_distance)).abs() < 0.0625 - 1e-5;
            let Some(i) = samples[0].iter().position(near) else { return };
            let [(_, s, own), (_, t, other)] = [samples[0][i], samples[1][i]];
            for c in 0..3 {
                let off = (f64::from(pixel.rgb[c]) - (s * own[c] + t * other[c]) / (s + t)).abs();
                assert!(off < 2e-5, "{off:e}");
            }
            seen += 1;
        };
        with_instances(&[&a.file, &b.file], kernel, Batch::FULL, |worker| {
            worker.sample_rays(&[ray.into(); 20], &random, None, &mut put).unwrap();
        });
    }
    assert!(seen > 100, "{seen}");
}
