//! Laws of the positional encoding at points that proptest draws; exact identities hold to the bit.

use crate::property::law;
use crate::table::{BACKENDS, Row, cases, isas};
use nerf_core::Isa;
use nerf_core::encoding::{AngleScale, SinusoidalEncoding, encode_block};
use nerf_core::math::MathBackend;
use nerf_testing::error::{worse, worst_of};
use proptest::prelude::{Strategy, any, prop_oneof};
use std::fmt;

cases! {
    sines_are_odd_and_cosines_even: "difference" => || points([0.0, 0.0, 2e-6, 0.0], symmetry);
    sines_and_cosines_lie_on_the_circle: "error of sin² + cos² = 1" => || points([4e-7, 1e-6, 5e-3, 2e-6], circle);
    whole_turns_change_no_bit: "difference; half a turn is reduced to π or −π" => || points([0.0, 1.8e-7, 0.0, 0.0], turns);
    a_level_is_the_first_of_a_multiple: "difference; the recurrence goes from level to level" => firsts;
    places_in_a_block_change_no_bit: "difference" => || points([0.0; 4], places);
}

/// Encoding that every law tests: 16 levels with π.
const ENCODING: SinusoidalEncoding =
    SinusoidalEncoding { inputs: 1, levels: LEVELS, scale: AngleScale::Pi, identity: false };
const LEVELS: u8 = 16;

/// A coordinate, and a number of whole turns.
#[derive(Clone, Debug)]
struct Point {
    x: f32,
    turns: i32,
}

impl fmt::Display for Point {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "x = {:e}", self.x)
    }
}

/// Draws coordinates of scenes, coordinates of every size up to 1e4, and multiples of powers of two.
fn any_point() -> impl Strategy<Value = Point> {
    let bits = any::<u32>().prop_map(f32::from_bits).prop_filter("up to 1e4", |x| x.abs() <= 1e4);
    let x = prop_oneof![
        3 => -2.0f32..2.0,
        2 => -1e4f32..1e4,
        2 => bits,
        2 => (-64i32..64, 0i32..20).prop_map(|(n, k)| n as f32 * 0.5f32.powi(k)),
    ];
    (x, -600i32..600).prop_map(|(x, turns)| Point { x, turns })
}

/// Returns half turns, whose reduced angle is π or −π; values so small that a turn would absorb them; and the worst
/// points of a long search.
fn known() -> impl Iterator<Item = Point> {
    [(3.0, -55), (1e-45, -1), (-0.0, 1), (1.885_880_8e-1, 7), (2.042_999_3e-1, 512)]
        .into_iter()
        .map(|(x, turns)| Point { x, turns })
}

/// Number of points per law and backend.
const POINTS: u32 = 4000;

fn points(bounds: [f64; 4], measure: fn(&Point, Isa, MathBackend) -> f64) -> Vec<Row> {
    points_of(&BACKENDS, &bounds, measure)
}

fn points_of(
    backends: &[(&'static str, MathBackend)],
    bounds: &[f64],
    measure: fn(&Point, Isa, MathBackend) -> f64,
) -> Vec<Row> {
    let backends = backends.iter().zip(bounds);
    backends
        .map(|(&(name, math), &bound)| {
            let seen = law(&any_point(), POINTS, known(), bound, |point| {
                let errors = isas().map(|isa| measure(point, isa, math));
                worst_of(errors)
            });
            seen.row(name, "exact", bound)
        })
        .collect()
}

/// Returns `(sin, cos)` of every level.
fn encode(x: f32, isa: Isa, math: MathBackend) -> [(f32, f32); LEVELS as usize] {
    let mut out = [0.0; 2 * LEVELS as usize * 16];
    encode_block(isa, math, &ENCODING, 16, &[x; 16], &mut out);
    std::array::from_fn(|level| (out[32 * level], out[32 * level + 16]))
}

/// Returns the largest difference between the numbers of two sequences; 0 and −0 do not differ.
fn differing(a: impl IntoIterator<Item = (f32, f32)>, b: impl IntoIterator<Item = (f32, f32)>) -> f64 {
    let pairs = a.into_iter().zip(b).flat_map(|(a, b)| [(a.0, b.0), (a.1, b.1)]);
    worst_of(pairs.map(|(a, b)| (f64::from(a) - f64::from(b)).abs()))
}

fn symmetry(point: &Point, isa: Isa, math: MathBackend) -> f64 {
    let mirrored = encode(-point.x, isa, math).map(|(sin, cos)| (-sin, cos));
    differing(encode(point.x, isa, math), mirrored)
}

fn circle(point: &Point, isa: Isa, math: MathBackend) -> f64 {
    let norms = encode(point.x, isa, math).map(|(sin, cos)| f64::from(sin).powi(2) + f64::from(cos).powi(2));
    worst_of(norms.iter().map(|norm| (norm - 1.0).abs()))
}

fn turns(point: &Point, isa: Isa, math: MathBackend) -> f64 {
    let shift = (2 * point.turns) as f32;
    let moved = point.x + shift;
    // Where the sum is exact (Knuth's test), it is whole turns on.
    if moved - shift != point.x || moved - point.x != shift {
        return 0.0;
    }
    differing(encode(point.x, isa, math), encode(moved, isa, math))
}

/// Measures whether level `k` of x is level 0 of `2^k x`. The recurrence is excluded, since it computes each level from
/// the level before.
fn firsts() -> Vec<Row> {
    assert_eq!(BACKENDS[3].1, MathBackend::Recurrence);
    points_of(&BACKENDS[..3], &[0.0; 3], first)
}

fn first(point: &Point, isa: Isa, math: MathBackend) -> f64 {
    let multiples = (0..LEVELS).map(|level| encode(point.x * 2f32.powi(level.into()), isa, math)[0]);
    differing(encode(point.x, isa, math), multiples)
}

fn places(point: &Point, isa: Isa, math: MathBackend) -> f64 {
    let alone = encode(point.x, isa, math);
    let mut changed: f64 = 0.0;
    for place in [0, 5, 15] {
        let mut x: [f32; 16] = std::array::from_fn(|i| (i as f32 - 7.3) * 11.0);
        x[place] = point.x;
        let mut out = [0.0; 2 * LEVELS as usize * 16];
        encode_block(isa, math, &ENCODING, 16, &x, &mut out);
        let among = (0..LEVELS as usize).map(|level| (out[32 * level + place], out[32 * level + 16 + place]));
        changed = worse(changed, differing(alone, among));
    }
    changed
}
