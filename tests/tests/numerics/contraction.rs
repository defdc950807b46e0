//! Errors of the contraction of unbounded space against the oracle.

use crate::geometry::somewhere;
use crate::table::{Row, Worst, cases, isas};
use glam::Vec3;
use nerf_core::Isa;
use nerf_core::simd::{Lanes, Op};
use nerf_core::space::Contraction;
use nerf_testing::noise::signed_f64;
use nerf_testing::oracle::contraction as oracle;

cases! {
    points_are_contracted: "error over the largest coordinate of the scene box, up to 1e6 radii away" => contracted;
    contracted_points_are_undone: "error of contract(in_world(p)), in f64, as above" => undone;
    steps_lead_to_their_distances: "relative error, over what rounding the step makes of it: 1 + p/b of b = 1 − (|s| − 1)/p, for the powers p 1, 2 and 4" => distances;
    distances_are_undone: "error of step_at(distance(s)), steps, over 1 + p" => steps;
    steps_stretch_as_their_distances_do: "relative error of the length of a step beside that in the ball, up to 100 radii away" => stretched;
}

/// Returns contractions with small and large balls, near and far from the origin.
fn contractions(power: u8) -> impl Iterator<Item = Contraction> {
    let balls = [
        (Vec3::ZERO, 1.0),
        (Vec3::new(100.0, -20.0, 5.0), 3.0),
        (Vec3::splat(0.1), 1e-3),
        (Vec3::new(-2e5, 4e5, 1e4), 1e3),
        (Vec3::splat(1e6), 4.0),
    ];
    balls.into_iter().map(move |(centre, radius)| {
        Contraction::new(&Contraction::cube(centre, radius), power).expect("a contraction")
    })
}

fn wide(p: Vec3) -> [f64; 3] {
    p.to_array().map(f64::from)
}

/// Returns the oracle's contraction of `p`, with the centre and radius of `c`.
fn truth(c: &Contraction, p: Vec3) -> [f64; 3] {
    oracle::contract(wide(c.centre()), f64::from(c.radius()), wide(p))
}

fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]).powi(2)).sum::<f64>().sqrt()
}

/// Returns a description of a contraction in words.
fn named(c: &Contraction) -> String {
    let [x, y, z] = c.centre().to_array();
    format!("a ball of radius {} around ({x}, {y}, {z}), power {}", c.radius(), c.power())
}

/// Returns the largest coordinate of the contraction's box.
fn largest(c: &Contraction) -> f64 {
    f64::from(c.centre().abs().max_element() + 2.0 * c.radius())
}

/// Returns points at distances of 1e-3 to 1e6 radii, and just inside and outside of the ball.
fn points(c: &Contraction) -> Vec<Vec3> {
    let mut state = 23;
    let rim = [1.0f32.next_down(), 1.0, 1.0f32.next_up()];
    let point = |i: usize| {
        let out = somewhere(&mut state).normalize_or(Vec3::X);
        let radii = rim.get(i % 97).copied().unwrap_or(10f32.powf(1.5 + 4.5 * signed_f64(&mut state) as f32));
        c.centre() + out * (radii * c.radius())
    };
    (0..9_600).map(point).collect()
}

/// Operation that contracts 16 world points and converts 16 steps to distances, in vectors.
struct Vectors<'a>(&'a Contraction, &'a [[f32; 16]; 4]);

impl Op for Vectors<'_> {
    type Output = [[f32; 16]; 4];

    #[inline(always)]
    fn run<V: Lanes>(self) -> Self::Output {
        let mut found = [[0.0; 16]; 4];
        for from in (0..16).step_by(V::COUNT) {
            let [x, y, z, s] = std::array::from_fn(|row| V::load(&self.1[row][from..]));
            let [x, y, z] = self.0.contract_lanes([x, y, z]);
            for (row, v) in found.iter_mut().zip([x, y, z, self.0.distance_lanes(s)]) {
                v.store(&mut row[from..]);
            }
        }
        found
    }
}

/// Contracts points and steps, sixteen at a time; calls `see` with each point and step and their results.
fn each(isa: Isa, c: &Contraction, steps: &[f32], mut see: impl FnMut(Vec3, Vec3, f32, f32)) {
    let points = points(c);
    for (index, block) in points.chunks_exact(16).enumerate() {
        let rows = std::array::from_fn(|row| {
            std::array::from_fn(|lane| match row {
                3 => steps[(16 * index + lane) % steps.len()],
                axis => block[lane][axis],
            })
        });
        let [x, y, z, t] = isa.run(Vectors(c, &rows));
        for lane in 0..16 {
            see(block[lane], Vec3::new(x[lane], y[lane], z[lane]), rows[3][lane], t[lane]);
        }
    }
}

fn contracted() -> Vec<Row> {
    let row = |isa: Isa| {
        let mut worst = Worst::default();
        for c in contractions(1) {
            each(isa, &c, &[0.0], |p, found, _, _| {
                worst.see(apart(wide(found), truth(&c, p)) / largest(&c), || format!("{p} of {}", named(&c)));
            });
        }
        worst.row("any", isa.name(), 2.4e-7)
    };
    isas().map(row).collect()
}

fn undone() -> Vec<Row> {
    let mut worst = Worst::default();
    for c in contractions(1) {
        for p in points(&c) {
            let p = c.contract(p);
            let found = truth(&c, c.in_world(p));
            worst.see(apart(found, wide(p)) / largest(&c), || format!("{p} of {}", named(&c)));
        }
    }
    vec![worst.row("any", "any", 2.4e-7)]
}

/// Returns steps of both signs, up to near the last valid one.
fn steps_of(power: u8) -> Vec<f32> {
    (-2_000..=2_000).map(|i| i as f32 / 2_000.0 * (1.0 + 0.98 * f32::from(power))).collect()
}

fn distances() -> Vec<Row> {
    let row = |isa: Isa| {
        let mut worst = Worst::default();
        for power in Contraction::POWERS {
            let p = f64::from(power);
            for c in contractions(power) {
                each(isa, &c, &steps_of(power), |_, _, s, found| {
                    let exact = oracle::distance(power, f64::from(s)) * f64::from(c.radius());
                    let base = (1.0 - (f64::from(s.abs()) - 1.0) / p).min(1.0);
                    let off = (f64::from(found) - exact).abs() / exact.abs().max(f64::MIN_POSITIVE);
                    worst.see(off / (1.0 + p / base), || format!("{s} of {}", named(&c)));
                });
            }
        }
        worst.row("any", isa.name(), 2.4e-7)
    };
    isas().map(row).collect()
}

fn steps() -> Vec<Row> {
    let mut worst = Worst::default();
    for power in Contraction::POWERS {
        for c in contractions(power) {
            for s in steps_of(power) {
                let off = f64::from(c.step_at(c.distance(s))) - f64::from(s);
                worst.see(off.abs() / (1.0 + f64::from(power)), || format!("{s} of {}", named(&c)));
            }
        }
    }
    vec![worst.row("any", "any", 2.4e-7)]
}

fn stretched() -> Vec<Row> {
    let mut worst = Worst::default();
    for power in Contraction::POWERS {
        // Far from the origin the contracted point itself has too few digits.
        let c = Contraction::new(&Contraction::cube(Vec3::ZERO, 1.0), power).expect("a contraction");
        for i in 0..=200 {
            let radii = 10f64.powf(0.01 * f64::from(i));
            let p = f64::from(power);
            let exact = radii.powf((p + 1.0) / p);
            let found = c.step_growth(c.contract(Vec3::Y * radii as f32));
            worst.see((f64::from(found) / exact - 1.0).abs(), || format!("{radii} radii of {}", named(&c)));
        }
    }
    // A digit of the contracted radius is `radii` of them here, twice for the power 1.
    vec![worst.row("any", "any", 100.0 * 2.0 * 2.4e-7)]
}
