//! Laws that span the crates: what an image may depend on, which scene files are valid, and checks of the f64 oracle.

mod blob_damage;
mod blob_header;
mod blob_shapes;
mod effects_cost;
mod fences;
mod large;
mod oracle;
mod parity;
mod rooms;
mod sizes;
mod words;

use proptest::test_runner::{Config, RngSeed};

/// Configures proptest to draw `cases` inputs, or `PROPTEST_CASES` if set. The inputs are the same in every run, so
/// that a local run equals a run in CI.
fn drawn(cases: u32) -> Config {
    let asked = std::env::var("PROPTEST_CASES").ok().map(|asked| asked.parse().expect("a number of cases"));
    let cases = asked.unwrap_or(cases);
    Config { cases, rng_seed: RngSeed::Fixed(0), failure_persistence: None, ..Config::default() }
}
