//! Laws over inputs that proptest draws and, where one fails, makes smaller.
//!
//! The stream of inputs is always the same, so that a run here is a run in CI. `PROPTEST_CASES` asks for more of them,
//! for each law that many. Nothing is persisted: the worst inputs that were ever found are written down beside their
//! law, and come before the drawn ones.

use crate::table::Worst;
use proptest::strategy::Strategy;
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestRng, TestRunner};
use std::cell::RefCell;
use std::fmt::{Debug, Display};

/// The worst that `measure` finds on the `known` inputs and on `cases` drawn ones.
///
/// # Panics
/// If one is beyond `bound`, with the smallest input proptest can find that is.
pub fn law<S: Strategy>(
    strategy: &S,
    cases: u32,
    known: impl IntoIterator<Item = S::Value>,
    bound: f64,
    measure: impl Fn(&S::Value) -> f64,
) -> Worst
where
    S::Value: Debug + Display,
{
    let asked = std::env::var("PROPTEST_CASES").ok().map(|asked| asked.parse().expect("a number of cases"));
    let config = Config { cases: asked.unwrap_or(cases), failure_persistence: None, ..Config::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha));
    let worst = RefCell::new(Worst::default());
    let check = |input: S::Value| {
        let error = measure(&input);
        worst.borrow_mut().see(error, || input.to_string());
        match error <= bound {
            true => Ok(()),
            false => Err(TestCaseError::fail(format!("{error:e} > {bound:e}"))),
        }
    };
    for input in known {
        let shown = format!("{input:?}");
        check(input).unwrap_or_else(|error| panic!("{error}: {shown}"));
    }
    runner.run(strategy, check).unwrap_or_else(|error| panic!("{error}"));
    worst.into_inner()
}
