//! Laws of sampling, on ranges, weights and positions in strata that proptest draws.

use super::{off, row_of};
use crate::property::law;
use crate::table::{Row, cases};
use nerf_core::sampling::{Bins, sample_interval};
use proptest::collection::vec;
use proptest::prelude::{Just, Strategy, any, prop_oneof};
use std::fmt;

cases! {
    any_weights_are_drawn_from: "error of the distribution function at the drawn samples, over what `draw` promises" => || rows(1.0, distribution);
    any_row_is_ascending_and_inside: "rows that are not" => || rows(0.0, order);
    any_row_has_every_middle: "middles that are missing" => || rows(0.0, missing);
    stretches_of_any_row_tile_the_range: "error of their sum, over the range" => || rows(6e-8, tiles);
    points_stay_in_their_bins: "points outside of bin or range" => bins;
}

/// Weights of a ray's bins, and the position of each drawn sample in its stratum.
#[derive(Clone, Debug)]
struct Weights {
    near: f32,
    far: f32,
    weights: Vec<f32>,
    drawn: usize,
    within: Vec<f32>,
}

impl fmt::Display for Weights {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { near, far, weights, drawn, .. } = self;
        write!(f, "{drawn} drawn from {} bins of {near:e} to {far:e}", weights.len())
    }
}

impl Weights {
    fn within(&self, k: u32) -> f32 {
        self.within[k as usize % self.within.len()]
    }

    fn row(&self) -> Vec<f32> {
        let bins = Bins::new(self.near, self.far, self.weights.len() as u32).expect("bins");
        row_of(&bins, &self.weights, self.drawn, |k| self.within(k))
    }
}

/// Draws ranges as scenes have them, and any other ranges.
fn range() -> impl Strategy<Value = (f32, f32)> {
    let scene = (0.0f32..10.0, (-3.0f32..3.0).prop_map(|e| 10f32.powf(e)))
        .prop_map(|(near, span)| (near, near + span));
    let any = (any::<u32>(), any::<u32>()).prop_map(|(a, b)| {
        let [a, b] = [a, b]
            .map(|bits| f32::from_bits(bits & 0x7fff_ffff))
            .map(|x| if x.is_finite() { x } else { 1.0 });
        (a.min(b), a.max(b))
    });
    prop_oneof![4 => scene, 1 => any]
}

/// Draws numbers in `[0, 1)`, both ends included.
fn unit() -> impl Strategy<Value = f32> {
    prop_oneof![1 => Just(0.0f32), 1 => Just(1f32.next_down()), 1 => Just(0.5f32), 5 => 0.0f32..1.0]
}

fn any_weights() -> impl Strategy<Value = Weights> {
    let weight = prop_oneof![
        3 => Just(0.0f32),
        3 => (-12.0f32..0.0).prop_map(|e| 10f32.powf(e)),
        3 => 0.0f32..=1.0,
        1 => any::<u32>().prop_map(f32::from_bits),
    ];
    let again = prop_oneof![4 => Just(1usize), 1 => 2usize..64];
    (range(), vec(weight, 1..64), again, 0usize..200, vec(unit(), 1..32))
        .prop_map(|((near, far), weights, again, drawn, within)| {
            let count = weights.len() * again;
            Weights { near, far, weights: weights.into_iter().cycle().take(count).collect(), drawn, within }
        })
        .prop_filter("a range with bins", |it| Bins::new(it.near, it.far, it.weights.len() as u32).is_ok())
}

/// Returns inputs that once violated a law: a last sample that was an ulp beyond `far`, and a range of subnormal
/// numbers.
fn known() -> Vec<Weights> {
    let mut within = vec![0.0; 8];
    within[3] = 1f32.next_down();
    vec![
        Weights { near: 0.0, far: 217.783_08, weights: vec![0.0; 43], drawn: 124, within },
        Weights { near: 0.0, far: 3.937_743e-39, weights: vec![0.0; 40], drawn: 0, within: vec![0.0] },
    ]
}

/// Number of inputs per law.
const ROWS: u32 = 1000;

fn rows(bound: f64, measure: fn(&Weights) -> f64) -> Vec<Row> {
    vec![law(&any_weights(), ROWS, known(), bound, measure).row("any", "any", bound)]
}

fn distribution(it: &Weights) -> f64 {
    off(it.near, it.far, &it.weights, it.drawn, |k| it.within(k))
}

fn order(it: &Weights) -> f64 {
    let row = it.row();
    let good =
        row.windows(2).all(|pair| pair[0] <= pair[1]) && row.iter().all(|t| (it.near..=it.far).contains(t));
    f64::from(u8::from(!good))
}

fn missing(it: &Weights) -> f64 {
    let bins = Bins::new(it.near, it.far, it.weights.len() as u32).expect("bins");
    let mut rest = it.row().into_iter();
    (0..bins.count()).filter(|&bin| !rest.by_ref().any(|t| t == bins.at(bin, 0.5))).count() as f64
}

/// Returns the error of the sum of the sample intervals, relative to the range. Neighbours share an edge; each width is
/// a difference of two edges with one rounding, 2^-24 of the width.
fn tiles(it: &Weights) -> f64 {
    let row = it.row();
    let widths: Vec<f32> = (0..row.len()).map(|k| sample_interval(it.near, it.far, &row, k).1).collect();
    let sum: f64 = widths.iter().map(|&width| f64::from(width)).sum();
    let range = f64::from(it.far) - f64::from(it.near);
    if widths.iter().all(|&width| width >= 0.0) { (sum - range).abs() / range } else { f64::INFINITY }
}

/// A position `u` in a bin.
#[derive(Clone, Debug)]
struct Point {
    near: f32,
    far: f32,
    count: u32,
    bin: u32,
    u: f32,
}

impl fmt::Display for Point {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { near, far, count, bin, u } = self;
        write!(f, "{u:e} of bin {bin} of {count}, {near:e} to {far:e}")
    }
}

fn bins() -> Vec<Row> {
    let point = (range(), 1u32..=4096, 0.0f32..1.0, unit()).prop_map(|((near, far), count, place, u)| {
        let place = if place > 0.9 { 1.0 } else { place };
        Point { near, far, count, bin: ((place * count as f32) as u32).min(count - 1), u }
    });
    let point = point.prop_filter("a range with bins", |p| Bins::new(p.near, p.far, p.count).is_ok());
    let outside = |p: &Point| {
        let bins = Bins::new(p.near, p.far, p.count).expect("bins");
        let t = bins.at(p.bin, p.u);
        let inside =
            (bins.at(p.bin, 0.0)..=bins.at(p.bin, 1.0)).contains(&t) && (p.near..=p.far).contains(&t);
        // The next bin begins where this one ends.
        let edge = p.bin + 1 < p.count && t == bins.at(p.bin + 1, 0.0);
        let around = bins.middle_around(t);
        // Bins without a number in between are all edge.
        let narrow = bins.delta() < 8.0 * f32::EPSILON * p.far;
        let own = narrow || around == bins.at(p.bin + u32::from(edge), 0.5);
        f64::from(u8::from(!(inside && own)))
    };
    // The front edge of a bin that once was taken for the bin's before it.
    let known = [Point { near: 6.590_017_3, far: 109.108_185, count: 399, bin: 102, u: 0.0 }];
    vec![law(&point, 20 * ROWS, known, 0.0, outside).row("any", "any", 0.0)]
}
