//! Laws of volume rendering on rays that proptest draws.

use super::{EXPONENTIALS, RAY, beyond, change, off, truth};
use crate::property::law;
use crate::table::{Row, cases};
use nerf_core::math::MathBackend;
use nerf_core::volume::{OPACITY_EPSILON, Pixel, composite};
use nerf_testing::error::{excess, worse, worst_of};
use proptest::collection::vec;
use proptest::prelude::{Just, Strategy, any, prop_oneof};
use std::fmt;

cases! {
    weights_and_what_is_left_make_one: "error of Σw + T = 1, and light above 1" => || rays([1e-6; 3], conservation);
    any_ray_is_the_oracle_s: "absolute error of colour and opacity" => || rays([RAY; 3], oracle);
    mean_distances_are_the_oracle_s: "error over `far`" => || rays([2e-6; 3], distance);
    distances_lie_where_the_ray_does: "how far outside of near to far, over `far`" => || rays([2e-7; 3], outside);
    splitting_any_bin_changes_nothing: "change of colour, opacity and transmittance" => || rays([1e-6; 3], split);
    what_is_empty_changes_no_bit: "pixels it changes" => || rays([0.0; 3], empty);
    what_is_behind_a_wall_changes_no_bit: "pixels it changes" => || rays([0.0; 3], behind);
    more_density_is_more_opacity: "how much less it is" => || rays([2e-7; 3], monotone);
    units_of_length_change_no_bit: "pixels that powers of two change" => || rays([0.0; 3], scaled);
    the_back_of_a_ray_is_a_background: "change of colour" => || rays([2.0 * RAY; 3], layered);
    any_bits_make_a_pixel: "pixels with a NaN or outside of their range" => bits;
}

/// A ray, with a position on it that some laws use.
#[derive(Clone, Debug)]
struct Ray {
    sigma: Vec<f32>,
    rgb: Vec<[f32; 3]>,
    edges: Vec<f32>,
    background: [f32; 3],
    /// Position of the bin, as a share of the number of bins, in `[0, 1)`.
    place: f32,
    /// Position in the bin, in `[0, 1)`.
    within: f32,
}

impl fmt::Display for Ray {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let most = self.sigma.iter().copied().fold(0.0, f32::max);
        let (n, far) = (self.sigma.len(), self.edges[self.sigma.len()]);
        write!(f, "{n} samples to {far:.3}, sigma up to {most:.2e}, bin {}", self.bin())
    }
}

impl Ray {
    fn bin(&self) -> usize {
        (self.place * self.sigma.len() as f32) as usize
    }

    fn pixel(&self, math: MathBackend) -> Pixel {
        composite(math, &self.sigma, &self.rgb, &self.edges, self.background).expect("a ray")
    }

    /// Returns the transmittance behind the last bin: the weight of an opaque wall there.
    fn left(&self, math: MathBackend) -> f32 {
        let n = self.sigma.len();
        let (mut sigma, mut edges) = (self.sigma.clone(), self.edges.clone());
        sigma.push(f32::INFINITY);
        edges.push(edges[n] + 1.0);
        let mut rgb = vec![[0.0; 3]; n];
        rgb.push([1.0; 3]);
        composite(math, &sigma, &rgb, &edges, [0.0; 3]).expect("a ray").rgb[0]
    }
}

/// Draws densities: 0, every size, the densities of fitted scenes, and opaque walls.
fn density() -> impl Strategy<Value = f32> {
    prop_oneof![
        2 => Just(0.0f32),
        3 => (-14.0f32..8.0).prop_map(|e| 10f32.powf(e)),
        4 => 0.0f32..40.0,
        1 => prop_oneof![Just(1e-30f32), Just(1e30), Just(f32::MAX), Just(f32::INFINITY)],
    ]
}

/// Draws rays of up to 4,096 bins, which repeat a few samples.
fn any_ray() -> impl Strategy<Value = Ray> {
    let sample =
        (density(), [0.0f32..=1.0, 0.0..=1.0, 0.0..=1.0], prop_oneof![1 => Just(0.0f32), 9 => 0.0f32..1.0]);
    let again = prop_oneof![6 => Just(1usize), 3 => 2usize..8, 1 => 8usize..64];
    let scale = (-6.0f32..1.0).prop_map(|e| 10f32.powf(e));
    let thin = prop_oneof![3 => Just(1.0f32), 1 => (-6.0f32..0.0).prop_map(|e| 10f32.powf(e))];
    let rest = ([0.0f32..=1.0, 0.0..=1.0, 0.0..=1.0], 0.0f32..1.0, 0.0f32..1.0, 0.0f32..8.0);
    (vec(sample, 1..64), again, scale, thin, rest).prop_map(|(samples, again, scale, thin, rest)| {
        let (background, place, within, near) = rest;
        let all = || samples.iter().cycle().take(samples.len() * again);
        let mut edges = vec![near];
        for (_, _, width) in all() {
            edges.push(edges[edges.len() - 1] + width * scale);
        }
        let sigma = all().map(|sample| sample.0 * thin).collect();
        Ray { sigma, rgb: all().map(|sample| sample.1).collect(), edges, background, place, within }
    })
}

/// Returns rays that once violated a law, or nearly.
fn known() -> Vec<Ray> {
    // A last term larger than all before it, then terms of 0: Kahan's sum moved by an ulp.
    let widths = [
        1.266_5e-3, 0.0, 1.778e-3, 3.5e-6, 0.0, 5.605e-4, 8.705e-4, 1.625e-3, 1.535_9e-3, 2.516e-4, 0.0, 0.0,
    ];
    let mut edges = vec![4.011_815_5f32];
    widths.iter().for_each(|width| edges.push(edges[edges.len() - 1] + width));
    let sigma = vec![0.0, 19.118_572, 132.075_12, 0.0, 1.687_527_9, 0.0, 28.195_345, 0.0, 1.0, 0.0, 0.0, 0.0];
    let wall = Ray { rgb: vec![[0.0; 3]; 12], sigma, edges, background: [0.0; 3], place: 0.769, within: 0.0 };
    let thin = Ray {
        sigma: vec![1e-30, f32::INFINITY, 1e-30, 1.0],
        rgb: vec![[1.0; 3]; 4],
        edges: vec![0.0, 1.0, 1.0, 3.0, 4.0],
        background: [1.0; 3],
        place: 0.5,
        within: 0.999,
    };
    vec![wall, thin]
}

/// Number of rays per law and backend.
const RAYS: u32 = 400;

fn rays(bounds: [f64; 3], measure: fn(&Ray, MathBackend) -> f64) -> Vec<Row> {
    let backends = EXPONENTIALS.iter().zip(bounds);
    backends
        .map(|(&(name, math), bound)| {
            let worst = law(&any_ray(), RAYS, known(), bound, |ray| measure(ray, math));
            worst.row(name, "any", bound)
        })
        .collect()
}

fn conservation(ray: &Ray, math: MathBackend) -> f64 {
    let (pixel, left) = (ray.pixel(math), ray.left(math));
    let light = worst_of(pixel.rgb.iter().map(|&c| f64::from(c) - 1.0));
    let valid = (0.0..=1.0).contains(&pixel.opacity) && (0.0..=1.0).contains(&left);
    let sum = (f64::from(pixel.opacity) + f64::from(left) - 1.0).abs();
    if valid { worse(sum, light) } else { f64::INFINITY }
}

fn oracle(ray: &Ray, math: MathBackend) -> f64 {
    let truth = truth(&ray.sigma, &ray.rgb, &ray.edges, ray.background);
    worse(off(&ray.pixel(math), &truth), (f64::from(ray.left(math)) - truth.transmittance).abs())
}

fn distance(ray: &Ray, math: MathBackend) -> f64 {
    let truth = truth(&ray.sigma, &ray.rgb, &ray.edges, ray.background);
    let (found, far) = (ray.pixel(math), ray.edges[ray.sigma.len()]);
    let epsilon = f64::from(OPACITY_EPSILON);
    // Where rounding decides whether there is a surface, either answer is right.
    if (truth.opacity / epsilon - 1.0).abs() < 1e-5 {
        return 0.0;
    }
    let expected = if truth.opacity > epsilon { truth.distance_sum / truth.opacity } else { f64::from(far) };
    (f64::from(found.ray_distance) - expected).abs() / f64::from(far).max(1e-30)
}

fn outside(ray: &Ray, math: MathBackend) -> f64 {
    beyond(&ray.pixel(math), ray.edges[0], ray.edges[ray.sigma.len()])
}

fn split(ray: &Ray, math: MathBackend) -> f64 {
    let (mut halves, bin) = (ray.clone(), ray.bin());
    let (start, end) = (ray.edges[bin], ray.edges[bin + 1]);
    halves.edges.insert(bin + 1, (start + ray.within * (end - start)).clamp(start, end));
    halves.sigma.insert(bin, ray.sigma[bin]);
    halves.rgb.insert(bin, ray.rgb[bin]);
    worse(
        change(&ray.pixel(math), &halves.pixel(math)),
        f64::from((ray.left(math) - halves.left(math)).abs()),
    )
}

fn empty(ray: &Ray, math: MathBackend) -> f64 {
    let (whole, bin) = (ray.pixel(math), ray.bin());
    let mut changed = 0.0;
    // A bin of no width, whatever is in it, in front of any other.
    for sigma in [0.0, 1.0, f32::MAX, f32::INFINITY, f32::NAN] {
        let mut more = ray.clone();
        more.edges.insert(bin + 1, ray.edges[bin]);
        more.sigma.insert(bin, sigma);
        more.rgb.insert(bin, [1.0, 0.0, ray.within]);
        changed += f64::from(u8::from(more.pixel(math) != whole));
    }
    // A bin without density, whatever its colour is and whatever says so.
    let with = |sigma: f32, rgb: [f32; 3]| {
        let mut other = ray.clone();
        (other.sigma[bin], other.rgb[bin]) = (sigma, rgb);
        other.pixel(math)
    };
    let none = with(0.0, [0.5; 3]);
    for (sigma, rgb) in
        [(-0.0, [1.0; 3]), (-1.0, [0.0; 3]), (f32::NAN, [1.0; 3]), (9.0, [0.0, f32::NAN, 0.0])]
    {
        changed += f64::from(u8::from(with(sigma, rgb) != none));
    }
    changed
}

fn behind(ray: &Ray, math: MathBackend) -> f64 {
    // A wall in front of everything from some bin on; its width is what it needs.
    let (mut wall, bin) = (ray.clone(), ray.bin());
    if wall.edges[bin + 1] == wall.edges[bin] {
        return 0.0;
    }
    wall.sigma[bin] = f32::INFINITY;
    let mut other = wall.clone();
    other.sigma[bin + 1..].reverse();
    other.rgb[bin + 1..].fill([ray.within; 3]);
    other.background = [1.0 - ray.within; 3];
    let mut none = wall.clone();
    none.sigma.truncate(bin + 1);
    none.rgb.truncate(bin + 1);
    none.edges.truncate(bin + 2);
    let (wall, other, none) = (wall.pixel(math), other.pixel(math), none.pixel(math));
    // What is left of the background is what rounding leaves of 1 − opacity.
    let same = |a: &Pixel, b: &Pixel| a.opacity == b.opacity && a.ray_distance == b.ray_distance;
    let all = wall == none && same(&wall, &other) && (wall.opacity < 1.0 || wall.rgb == other.rgb);
    f64::from(u8::from(!all))
}

fn monotone(ray: &Ray, math: MathBackend) -> f64 {
    let (mut denser, bin) = (ray.clone(), ray.bin());
    denser.sigma[bin] = (denser.sigma[bin] * (1.0 + ray.within)).max(ray.within * 1e-3);
    excess(f64::from(ray.pixel(math).opacity) - f64::from(denser.pixel(math).opacity))
}

fn scaled(ray: &Ray, math: MathBackend) -> f64 {
    let whole = ray.pixel(math);
    let mut changed = 0.0;
    for scale in [2f32.powi(-12), 0.5, 2.0, 2f32.powi(12)] {
        let mut other = ray.clone();
        // Exact, but where a number leaves the normal ones: there is no such ray then.
        other.edges.iter_mut().for_each(|t| *t *= scale);
        other.sigma.iter_mut().for_each(|sigma| *sigma /= scale);
        let back = |(a, b): (&f32, &f32)| a / scale == *b || !b.is_finite();
        if !ray.sigma.iter().zip(&other.sigma).all(|(a, b)| b * scale == *a && (*a == 0.0 || b.is_normal()))
            || !other.edges.iter().zip(&ray.edges).all(back)
        {
            continue;
        }
        let found = other.pixel(math);
        let same = found.rgb == whole.rgb && found.opacity == whole.opacity;
        let distance = found.ray_distance == whole.ray_distance * scale;
        changed += f64::from(u8::from(!same || !distance));
    }
    changed
}

fn layered(ray: &Ray, math: MathBackend) -> f64 {
    let bin = ray.bin();
    let part = |from: usize, to: usize, background: [f32; 3]| Ray {
        sigma: ray.sigma[from..to].to_vec(),
        rgb: ray.rgb[from..to].to_vec(),
        edges: ray.edges[from..=to].to_vec(),
        background,
        ..*ray
    };
    let back = part(bin, ray.sigma.len(), ray.background).pixel(math);
    let front = part(0, bin, back.rgb).pixel(math);
    let whole = ray.pixel(math);
    worst_of((0..3).map(|c| f64::from((front.rgb[c] - whole.rgb[c]).abs())))
}

/// Draws rays with arbitrary bits for densities and edges, and with any colour that a network can give.
fn any_bits() -> impl Strategy<Value = Ray> {
    let edges = vec(any::<u32>().prop_map(f32::from_bits), 2..40);
    let samples = vec((any::<u32>().prop_map(f32::from_bits), [0.0f32..=1.0, 0.0..=1.0, 0.0..=1.0]), 40);
    (edges, samples, [0.0f32..=1.0, 0.0..=1.0, 0.0..=1.0]).prop_map(|(mut edges, samples, background)| {
        edges.retain(|t| t.is_finite());
        edges.extend([0.0, 1.0]);
        edges.sort_by(f32::total_cmp);
        let samples = &samples[..edges.len() - 1];
        let (sigma, rgb) = samples.iter().copied().unzip();
        Ray { sigma, rgb, edges, background, place: 0.0, within: 0.0 }
    })
}

fn bits() -> Vec<Row> {
    let strange = |ray: &Ray, math| {
        let pixel = ray.pixel(math);
        let colour = pixel.rgb.iter().all(|c| (0.0..=1.0 + 1e-6).contains(c));
        let range = ray.edges[0]..=ray.edges[ray.sigma.len()];
        let size = range.start().abs().max(range.end().abs()) * 1e-6;
        let distance = pixel.ray_distance.is_finite()
            && pixel.ray_distance >= range.start() - size
            && pixel.ray_distance <= range.end() + size;
        f64::from(u8::from(!(colour && (0.0..=1.0).contains(&pixel.opacity) && distance)))
    };
    EXPONENTIALS
        .iter()
        .map(|&(name, math)| law(&any_bits(), RAYS, [], 0.0, |ray| strange(ray, math)).row(name, "any", 0.0))
        .collect()
}
