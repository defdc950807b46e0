//! The table of worst errors: what each case measured, beside its bound, and `nerf-core/docs/numerics.md`.

use nerf_core::kernels::Tier;
use nerf_core::math::MathBackend;
use nerf_tests::paths;
use std::sync::OnceLock;

/// One line of the table.
#[derive(Clone, Debug)]
pub struct Row {
    /// Maths backend, or "any" where none takes part.
    pub backend: &'static str,
    /// Kernel tiers it holds on.
    pub tier: &'static str,
    /// The worst that was seen.
    pub observed: f64,
    /// What it may be at most.
    pub bound: f64,
    /// Where the worst was seen.
    pub at: String,
}

/// A case of the table: measured once in a run of the tests, whoever asks.
pub struct Case {
    /// The test's name.
    pub name: &'static str,
    /// What is measured, with its unit.
    pub what: &'static str,
    /// Measures it.
    pub measure: fn() -> Vec<Row>,
    /// What was measured.
    pub rows: OnceLock<Vec<Row>>,
}

impl Case {
    /// The measured rows, none of which may exceed its bound.
    pub fn check(&self) -> &[Row] {
        let rows = self.rows.get_or_init(self.measure);
        assert!(!rows.is_empty(), "{}: nothing was measured", self.name);
        for row in rows {
            let Row { backend, tier, observed, bound, at } = row;
            println!("{}: {backend}, {tier}: {observed:.2e} of {bound:.1e}, {at}", self.name);
            // Not `>`: a NaN is no success.
            assert!(observed <= bound, "{}: {backend}, {tier}: {observed:e} > {bound:e}, {at}", self.name);
        }
        rows
    }
}

/// Declares the cases of a section, each a test of its own.
macro_rules! cases {
    ($($name:ident: $what:literal => $measure:expr;)*) => {
        /// The section's cases.
        pub static CASES: &[&crate::table::Case] = &[$(&statics::$name),*];

        #[allow(non_upper_case_globals, reason = "each is the name of its test")]
        mod statics {
            use super::*;
            $(pub static $name: crate::table::Case = crate::table::Case {
                name: stringify!($name),
                what: $what,
                measure: $measure,
                rows: std::sync::OnceLock::new(),
            };)*
        }

        $(#[test]
        fn $name() {
            statics::$name.check();
        })*
    };
}
pub(crate) use cases;

/// Backends by name.
pub const BACKENDS: [(&str, MathBackend); 4] = [
    ("polynomial", MathBackend::Polynomial),
    ("libm", MathBackend::Libm),
    ("micromath", MathBackend::Micromath),
    ("recurrence", MathBackend::Recurrence),
];

/// The tiers that compute in f32.
pub fn exact_tiers() -> impl Iterator<Item = Tier> {
    nerf_tests::scenes::tiers().filter(|tier| !tier.rounds())
}

/// Keeps the worst of what it is shown.
#[derive(Clone, Debug, Default)]
pub struct Worst {
    /// The largest error; NaN once one was NaN.
    pub error: f64,
    /// Where.
    pub at: String,
}

impl Worst {
    /// Shows it an error and where it is.
    pub fn see(&mut self, error: f64, at: impl FnOnce() -> String) {
        // A NaN is the worst there is.
        if error > self.error || (error.is_nan() && !self.error.is_nan()) {
            (self.error, self.at) = (error, at());
        }
    }

    /// Its row.
    pub fn row(self, backend: &'static str, tier: &'static str, bound: f64) -> Row {
        Row { backend, tier, observed: self.error, bound, at: self.at }
    }
}

/// The page, of what this run measures.
pub fn page(sections: &[(&str, &[&Case])]) -> String {
    let mut page = String::from(HEAD);
    let step = if crate::elementary::exhaustive() { "every f32" } else { "every 1,009th f32" };
    page += &format!("This page is of a run with {step}.\n");
    for (title, cases) in sections {
        page += &format!(
            "\n## {title}\n\n| case | backend | tiers | worst | bound | where |\n| --- | --- | --- | --- | --- | --- |\n"
        );
        for case in *cases {
            for row in case.check() {
                let Row { backend, tier, observed, bound, at } = row;
                let what = format!("{}: {}", case.name.replace('_', " "), case.what);
                page += &format!("| {what} | {backend} | {tier} | {observed:.1e} | {bound:.1e} | {at} |\n");
            }
        }
    }
    page
}

const HEAD: &str = "\
# Numerics

Every case below is a test of its own in `tests/tests/numerics/`, against the f64 oracle of `tests/src/oracle/`.
`worst` is what the run that wrote this page saw on one machine; `bound` is what the test allows. 0 means: no
error at all, or a law that holds without exception.

Written by `NERF_BLESS=numerics cargo test --release -p nerf-tests --test numerics`; the same command without `NERF_BLESS`
checks it. Elementary functions take every 1,009th f32 of their domain, or with `NERF_EXHAUSTIVE=1` every one.
";

/// The page in the repository.
pub fn path() -> std::path::PathBuf {
    paths::workspace().join("nerf-core/docs/numerics.md")
}
