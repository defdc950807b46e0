//! Laws, checked on inputs that proptest draws; an input that violates a law is reduced to a smaller one.
//!
//! The inputs are the same in every run, so that a local run equals a run in CI. `PROPTEST_CASES` sets the number of
//! inputs for each law. proptest stores no inputs: the worst inputs ever found are listed in the code beside their law,
//! and are checked before the drawn ones.

use crate::table::Worst;
use proptest::strategy::Strategy;
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestRng, TestRunner};
use std::cell::RefCell;
use std::fmt::{Debug, Display};

/// Returns the largest error that `measure` finds on the `known` inputs and on `cases` drawn inputs.
///
/// # Panics
/// If an error exceeds `bound`; the message contains the smallest failing input that proptest finds.
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
