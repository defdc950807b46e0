//! Laws that span the crates: what a picture depends on, what a blob must be, what the f64 oracle itself is checked by.

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

/// `cases` inputs that proptest draws: always the same, so that a run here is a run in CI. `PROPTEST_CASES` asks for
/// another number of them.
fn drawn(cases: u32) -> Config {
    let asked = std::env::var("PROPTEST_CASES").ok().map(|asked| asked.parse().expect("a number of cases"));
    let cases = asked.unwrap_or(cases);
    Config { cases, rng_seed: RngSeed::Fixed(0), failure_persistence: None, ..Config::default() }
}
