extern crate std;

use super::*;
use crate::simd::{Isa, Op};
#[cfg(feature = "normals")]
use crate::testing::Worse;
use crate::testing::noise;
use std::vec::Vec;

const EPS: f64 = f32::EPSILON as f64;

/// Centres and radii of inner balls: near and far from the origin, small and large.
fn balls() -> [(Vec3, f32); 5] {
    [
        (Vec3::ZERO, 1.0),
        (Vec3::new(100.0, -20.0, 5.0), 3.0),
        (Vec3::splat(0.1), 1e-3),
        (Vec3::new(-2e5, 4e5, 1e4), 1e3),
        (Vec3::splat(1e6), 4.0),
    ]
}

fn contraction(centre: Vec3, radius: f32, power: u8) -> Contraction {
    Contraction::new(&Contraction::cube(centre, radius), power).unwrap()
}

type Point = [f64; 3];

fn wide(p: Vec3) -> Point {
    p.to_array().map(f64::from)
}

fn narrow(p: Point) -> Vec3 {
    Vec3::from(p.map(|x| x as f32))
}

fn length(p: Point) -> f64 {
    p.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Returns the point `a + b · dir`.
fn along(a: Point, b: f64, dir: Point) -> Point {
    core::array::from_fn(|axis| a[axis] + b * dir[axis])
}

fn from(a: Point, b: Point) -> f64 {
    length(along(a, -1.0, b))
}

fn dirs() -> impl Iterator<Item = Point> {
    let axes = [Vec3::X, Vec3::NEG_Y, Vec3::new(1.0, 0.0, -1.0), Vec3::ONE];
    axes.into_iter().chain((0..20).map(|i| Vec3::from_slice(&noise(3, i)))).map(|dir| {
        let dir = wide(dir);
        dir.map(|x| x / length(dir))
    })
}

/// Contracts `p` in f64 by the definition, with the centre and radius of `c`.
fn contract(c: &Contraction, p: Point) -> Point {
    let q = along(p, -1.0, wide(c.centre())).map(|x| x / f64::from(c.radius()));
    let r = length(q);
    let shrink = if r <= 1.0 { 1.0 } else { (2.0 - 1.0 / r) / r };
    along(wide(c.centre()), shrink * f64::from(c.radius()), q)
}

fn distance(c: &Contraction, s: f64) -> f64 {
    let p = f64::from(c.power());
    let size = if s.abs() <= 1.0 { s.abs() } else { (1.0 - (s.abs() - 1.0) / p).powf(-p) };
    size.copysign(s) * f64::from(c.radius())
}

/// Rounding error of f32 at the largest numbers involved: the centre's coordinates and the box's sides.
fn rounding(c: &Contraction) -> f64 {
    EPS * f64::from(c.centre().abs().max_element() + 4.0 * c.radius())
}

#[test]
fn points_are_where_the_definition_has_them_and_back() {
    let rim = [1.0f32.next_down(), 1.0, 1.0f32.next_up()];
    let radii = [0.0, 1e-30, 1e-3, 0.5, 1.001, 1.5, 10.0, 1e3, 1e6].into_iter().chain(rim.map(f64::from));
    for (centre, radius) in balls() {
        let c = contraction(centre, radius, 1);
        for (r, dir) in radii.clone().flat_map(|r| dirs().map(move |dir| (r, dir))) {
            let p = narrow(along(wide(c.centre()), r * f64::from(c.radius()), dir));
            let found = c.contract(p);
            let error = from(wide(found), contract(&c, wide(p)));
            assert!(error <= 2.0 * rounding(&c), "{centre} {radius}: {p} to {found}, off {error:e}");
            // An error of the contracted radius is (2 − contracted)^−2 = r² times as large in the world.
            let error = from(wide(c.in_world(found)), wide(p));
            let bound = 4.0 * rounding(&c) * (r * r).max(1.0);
            let tells = bound < 0.1 * r.max(1.0) * f64::from(c.radius());
            assert!(error <= bound || !tells, "{p} back off {error:e}");
        }
    }
}

#[test]
fn nothing_leaves_the_box() {
    let values = [0.0, -0.0, 1e-30, 1.0, -1e6, 1e30, f32::MAX, f32::MIN, f32::INFINITY, f32::NEG_INFINITY];
    for (centre, radius) in balls() {
        let cube = Contraction::cube(centre, radius);
        let c = contraction(centre, radius, 1);
        for x in values {
            for y in values {
                for z in values {
                    let p = c.contract(Vec3::new(x, y, z));
                    assert!(cube.contains(p), "{x} {y} {z} of {cube:?} at {p}");
                    let out = from(wide(p), wide(c.centre())) / f64::from(c.radius());
                    assert!(out <= 2.0 + rounding(&c) / f64::from(c.radius()));
                    if [x, y, z].iter().any(|v| v.abs() >= 1e30) {
                        assert!(out >= 2.0 - 2.0 * rounding(&c) / f64::from(c.radius()), "{out}");
                    }
                }
            }
        }
        assert_eq!(c.contract(Vec3::NAN), c.centre());
    }
}

#[test]
fn what_is_no_cube_or_power_is_no_contraction() {
    let cube = |radius| Contraction::cube(Vec3::new(0.5, 0.0, -0.5) * radius, radius);
    for power in 0..=u8::MAX {
        let expected = Contraction::POWERS.contains(&power);
        assert_eq!(Contraction::new(&cube(1.0), power).is_some(), expected, "power {power}");
    }
    for radius in [1e-30, 1.0, 1e30] {
        let found = Contraction::new(&cube(radius * 1.001f32.powi(if radius < 1.0 { 1 } else { -1 })), 1);
        assert!(found.is_some(), "{radius}");
    }
    for radius in [0.0, -1.0, 1e-31, 2e30, 1e38, f32::INFINITY, f32::NAN] {
        assert_eq!(Contraction::new(&cube(radius), 1), None, "{radius}");
    }
    for axis in 0..3 {
        for off in [-0.01, 0.01, f32::NAN] {
            let mut flat = cube(1.0);
            flat.max[axis] += off;
            assert_eq!(Contraction::new(&flat, 1), None, "{off} along axis {axis}");
        }
    }
    // f32 has too few digits for this radius at this distance from the origin.
    assert_eq!(Contraction::new(&Contraction::cube(Vec3::splat(1e6), 0.1), 1), None);
}

/// Error bounds come from rounding of a position `s` on a ray, as [`Contraction::distance`] takes it: with power `p`,
/// `|s| <= 1 + p`.
#[test]
fn steps_and_distances_are_inverse_within_rounding() {
    for (centre, radius) in balls() {
        for power in Contraction::POWERS {
            let c = contraction(centre, radius, power);
            let (p, of) = (f64::from(power), f64::from(c.radius()));
            let mut before = f32::NEG_INFINITY;
            for i in -1000..=1000 {
                let s = i as f32 / 1000.0 * (1.0 + 0.98 * f32::from(power));
                let found = c.distance(s);
                let exact = distance(&c, s.into());
                // Bound from the rounding of the base (p + 1 − |s|) / p, whose power −p is the distance.
                let base = ((p + 1.0 - f64::from(s.abs())) / p).min(1.0);
                let bound = 2.0 * EPS * (1.0 + p / base);
                assert!(
                    (f64::from(found) - exact).abs() <= bound * exact.abs(),
                    "{power} {s}: {found} {exact}"
                );
                assert!(found > before, "{power} {s}: distances grow");
                let error = (c.step_at(found) - s).abs();
                assert!(f64::from(error) <= 4.0 * EPS * (1.0 + p), "{power} {s}: back off {error:e}");
                before = found;
            }
            for size in [1e-30, 1e-4, 0.5, 1.0, 1.0 + 1e-6, 3.0, 100.0, 1e3, 1e6] {
                for d in [size * of, -size * of] {
                    let found = f64::from(c.distance(c.step_at(d as f32)));
                    let bound = 4.0 * EPS * (1.0 + p * size.max(1.0).powf(1.0 / p));
                    assert!((found - d).abs() <= bound * d.abs(), "{power} {d}: {found}");
                }
            }
            for beyond in [f32::MAX, f32::INFINITY] {
                assert_eq!(c.step_at(-beyond), -c.step_at(beyond));
                assert!(c.step_at(beyond) <= 1.0 + f32::from(power));
                assert!(
                    c.distance(beyond).is_finite() && c.distance(1.0 + f32::from(power)) >= 9e7 * c.radius()
                );
            }
        }
    }
}

/// Contracts 16 points (rows x, y, z), and converts 16 positions `s` (row s) to distances.
struct All<'a>(&'a Contraction, &'a [[f32; 16]; 4]);

impl Op for All<'_> {
    type Output = [[f32; 16]; 4];

    #[inline(always)]
    fn run<V: Lanes>(self) -> Self::Output {
        let mut found = [[0.0; 16]; 4];
        for from in (0..16).step_by(V::COUNT) {
            let [x, y, z, s] = core::array::from_fn(|row| V::load(&self.1[row][from..]));
            let points = self.0.contract_lanes([x, y, z]);
            for (row, v) in found.iter_mut().zip([points[0], points[1], points[2], self.0.distance_lanes(s)])
            {
                v.store(&mut row[from..]);
            }
        }
        found
    }
}

#[test]
fn lanes_of_every_isa_are_the_portable_ones() {
    let odd =
        [0.0, -0.0, 1.0, -1.0, 1e-30, 1e30, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, f32::MAX, 2.0, 5.0];
    for (k, (centre, radius)) in balls().into_iter().enumerate() {
        for power in Contraction::POWERS {
            let c = contraction(centre, radius, power);
            for i in 0..50u32 {
                let r = noise(64, i + 100 * k as u32);
                let scale = 10f32.powi(i as i32 % 9 - 3) * radius;
                let rows = core::array::from_fn(|row| {
                    core::array::from_fn(|lane| match (row, i) {
                        (_, 0) => odd[(lane * (row + 1)) % odd.len()],
                        (3, _) => r[48 + lane] * (1.5 + f32::from(power)),
                        _ => centre[row] + r[row * 16 + lane] * scale,
                    })
                });
                let expected: [Vec<f32>; 4] = {
                    let points: Vec<Vec3> = (0..16)
                        .map(|lane| c.contract(Vec3::new(rows[0][lane], rows[1][lane], rows[2][lane])))
                        .collect();
                    core::array::from_fn(|row| match row {
                        3 => rows[3].iter().map(|&s: &f32| c.distance(s)).collect(),
                        _ => points.iter().map(|p| p[row]).collect(),
                    })
                };
                for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
                    let found = isa.run(All(&c, &rows));
                    for (found, expected) in found.iter().zip(&expected) {
                        let bits = |x: &f32| x.to_bits();
                        let (found, expected) = (found.iter().map(bits), expected.iter().map(bits));
                        assert!(found.eq(expected), "{} {rows:?}", isa.name());
                    }
                }
            }
        }
    }
}

#[cfg(feature = "normals")]
#[test]
fn gradients_in_the_world_are_those_of_what_is_contracted() {
    let mut worst = 0.0;
    for (centre, radius) in balls() {
        let c = contraction(centre, radius, 1);
        for (k, dir) in dirs().enumerate() {
            let gradient = Vec3::from_slice(&noise(3, 50 + k as u32));
            for r in [0.0f64, 0.3, 0.999, 1.01, 2.0, 10.0, 100.0] {
                let of = f64::from(c.radius());
                let p = along(wide(c.centre()), r * of, dir);
                let value =
                    |p: Point| contract(&c, p).iter().zip(wide(gradient)).map(|(x, g)| x * g).sum::<f64>();
                let step = 1e-5 * of * r.max(1.0);
                let expected: Point = core::array::from_fn(|axis| {
                    let axis = wide(Vec3::AXES[axis]);
                    (value(along(p, step, axis)) - value(along(p, -step, axis))) / (2.0 * step)
                });
                let found = wide(c.gradient_in_world(c.contract(narrow(p)), gradient));
                // The contracted point is rounded to f32. This error, relative to the gradient, grows with r.
                let digits = 8.0 * rounding(&c) / of * r.max(1.0);
                // The oracle's finite differences lose digits far from the origin.
                let oracle = 1e-9 + 1e-15 * length(p) / step;
                let error = from(found, expected) / length(expected);
                worst = f64::worse(worst, error / (digits + oracle + 1e-6));
                assert!(error <= digits + oracle * r.max(1.0) + 1e-6, "{centre} {radius} {r}: {error:e}");
            }
        }
    }
    std::println!("{worst:e} of the bound");
}

#[test]
fn rays_are_counted_from_their_point_nearest_to_the_middle() {
    let c = contraction(Vec3::new(1.0, 2.0, 3.0), 2.0, 1);
    let ray = |origin: [f32; 3], dir: Vec3| Ray { origin: origin.into(), dir };
    // Rays through the centre, tangent to the ball, from inside it, from the centre, and away from the ball.
    for (ray, nearest, start) in [
        (ray([-9.0, 2.0, 3.0], Vec3::X), [1.0, 2.0, 3.0], 10.0),
        (ray([1.0, 4.0, 103.0], Vec3::NEG_Z), [1.0, 4.0, 3.0], 100.0),
        (ray([1.0, 1.0, 4.0], Vec3::Y), [1.0, 2.0, 4.0], 1.0),
        (ray([1.0, 2.0, 3.0], Vec3::Z), [1.0, 2.0, 3.0], 0.0),
        (ray([11.0, 2.0, 3.0], Vec3::X), [11.0, 2.0, 3.0], 0.0),
    ] {
        let (centred, found) = c.centred(&ray);
        assert_eq!((centred.origin.to_array(), centred.dir, found), (nearest, ray.dir, start));
    }
}

/// Compares [`Contraction::step_growth`], the length of a march step divided by its length in the uncontracted ball,
/// with finite differences of the distance along a ray through the centre.
#[test]
fn steps_stretch_as_distances_grow() {
    for power in Contraction::POWERS {
        let c = contraction(Vec3::ONE, 2.0, power);
        for r in [0.2, 0.9, 1.5, 10.0, 300.0] {
            let s = c.step_at(2.0 * r);
            let (h, s) = (1e-5, f64::from(s));
            let expected = (distance(&c, s + h) - distance(&c, s - h)) / (2.0 * h) / 2.0;
            let found = f64::from(c.step_growth(c.contract(Vec3::ONE + Vec3::X * 2.0 * r)));
            assert!((found / expected - 1.0).abs() < 1e-3, "{power} {r}: {found} {expected}");
        }
    }
}
