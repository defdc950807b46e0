//! Errors of the intersection of rays and boxes against the oracle.

use crate::table::{Row, Worst, cases};
use glam::Vec3;
use nerf_core::camera::Ray;
use nerf_core::space::SceneBox;
use nerf_testing::error::excess;
use nerf_testing::noise::signed_f64;
use nerf_testing::oracle;

cases! {
    boxes_are_entered_and_left: "error of t over 100,000 rays, hard ones among them, relative to t itself; a hit where there is none, or none where there is one, is 1" => boxes;
    numbers_of_every_size_in_a_ray: "error of t, relative to t itself; a hit where there is none is 1" => sizes;
}

/// Returns a random point of the cube of side 2 around the origin.
pub fn somewhere(state: &mut u64) -> Vec3 {
    Vec3::from_array([0; 3].map(|_| signed_f64(state) as f32))
}

/// Returns difficult rays: with origins on faces, edges and corners, parallel to faces, along diagonals, from inside.
fn hard_rays() -> Vec<Ray> {
    let values = [-1.0f32, 1.0, 0.0, -0.0, 0.5, 1.0f32.next_up(), 1.0f32.next_down(), 4.0, 1e-38, 1e6];
    let dirs = [0.0f32, -0.0, 1.0, -1.0, 1e-30, 1e-7, 0.707_106_77];
    let mut rays = Vec::new();
    for x in values {
        for y in values {
            for (i, dx) in dirs.into_iter().enumerate() {
                for dy in dirs {
                    let z = values[(i + rays.len()) % values.len()];
                    rays.push(Ray { origin: Vec3::new(x, y, z), dir: Vec3::new(dx, dy, -1.0).normalize() });
                }
            }
        }
    }
    let mut state = 17;
    while rays.len() < 100_000 {
        let origin = 3.0 * somewhere(&mut state);
        let dir = (somewhere(&mut state) - origin).normalize();
        rays.push(Ray { origin, dir });
    }
    rays
}

/// Bound: the errors of a difference and a quotient, each at most half a unit in the last place.
const ROUNDED_TWICE: f64 = 1.2e-7;

fn unit_box() -> SceneBox {
    SceneBox::new(Vec3::NEG_ONE, Vec3::ONE).expect("a box")
}

fn boxes() -> Vec<Row> {
    let mut worst = Worst::default();
    for ray in hard_rays() {
        see_range(&mut worst, &ray, 0.0, 1e7);
    }
    vec![worst.row("any", "any", ROUNDED_TWICE)]
}

/// Numbers that break slab tests: zeros, the smallest and largest numbers, infinity, NaN, and coordinates of the box's
/// faces.
const NUMBERS: [f32; 15] = [
    0.0,
    -0.0,
    1e-45,
    -f32::MIN_POSITIVE,
    1e-30,
    -1e-7,
    1.0,
    -1.0,
    1.0f32.next_up(),
    0.5,
    1e6,
    -1e30,
    3e38,
    f32::INFINITY,
    f32::NAN,
];

/// Measures rays whose origins and directions are triples of [`NUMBERS`], in unusual ranges: every triple as an origin,
/// with 97 directions each.
fn sizes() -> Vec<Row> {
    let n = NUMBERS.len();
    let triple = |i: usize| Vec3::new(NUMBERS[i % n], NUMBERS[i / n % n], NUMBERS[i / n / n % n]);
    let ranges = [
        (0.0f32, 1e30f32),
        (1.0, 6.0),
        (2.0, 2.0),
        (6.0, 1.0),
        (0.0, f32::MAX),
        (-3.0, 1e-45),
        (f32::NAN, 1.0),
        (0.0, f32::NAN),
    ];
    let mut worst = Worst::default();
    for i in 0..n * n * n {
        // 3,375 of either; 31 and 47 have no factor in common with that number.
        for j in 0..97 {
            let (origin, dir) = (triple(i), triple(31 * i + 47 * j));
            let (near, far) = ranges[(i + j) % ranges.len()];
            see_range(&mut worst, &Ray { origin, dir }, near, far);
        }
    }
    vec![worst.row("any", "any", ROUNDED_TWICE)]
}

fn see_range(worst: &mut Worst, ray: &Ray, near: f32, far: f32) {
    let found = unit_box().clip(ray, near, far);
    let at = || format!("{ray:?}, {near:e}..{far:e}");
    let numbers = ray.origin.is_finite() && ray.dir.is_finite() && near <= far;
    // What is parallel to a face within the least normal number is parallel: it moves by 1 in 1e38.
    let flat = |d: f32| if d.abs() < f32::MIN_POSITIVE { 0.0 } else { f64::from(d) };
    let (o, d) = (ray.origin.to_array().map(f64::from), ray.dir.to_array().map(flat));
    let truth = oracle::sampling::clip(o, d, [-1.0; 3], [1.0; 3], f64::from(near), f64::from(far));
    match (truth.filter(|_| numbers), found) {
        (Some((a, b)), Some((enter, exit))) => {
            for (found, truth) in [(enter, a), (exit, b)] {
                // What is no normal number has an absolute error, half of the least.
                let off = (f64::from(found) - truth).abs() - f64::from(1e-45f32);
                worst.see(excess(off) / truth.abs().max(1e-300), at);
            }
        }
        // Nearly touched: the interval may close by its own rounding.
        (Some((a, b)), None) => {
            worst.see(if b - a > ROUNDED_TWICE * (a.abs() + b.abs()) { 1.0 } else { 0.0 }, at)
        }
        (None, Some((enter, exit))) => {
            let near_miss =
                numbers && f64::from(exit - enter) <= ROUNDED_TWICE * f64::from(enter.abs() + exit.abs());
            worst.see(if near_miss { 0.0 } else { 1.0 }, at);
        }
        (None, None) => {}
    }
}
