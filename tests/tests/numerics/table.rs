//! Table of the worst errors: the measured error of each case, beside its bound, as in `nerf-core/docs/numerics.md`.

use nerf_core::math::MathBackend;
use nerf_core::{Isa, Kernel};
use nerf_testing::paths;
use std::sync::OnceLock;

/// One line of the table.
#[derive(Clone, Debug)]
pub struct Row {
    /// Maths backend; "any" for cases without a backend.
    pub backend: &'static str,
    /// Kernels that the row covers.
    pub kernel: &'static str,
    /// Largest measured error.
    pub observed: f64,
    /// Largest allowed error.
    pub bound: f64,
    /// Input with the largest error.
    pub at: String,
}

/// A case of the table. Its rows are measured once per test run, on first use.
pub struct Case {
    /// Name of the test.
    pub name: &'static str,
    /// Description of the measured quantity, with its unit.
    pub what: &'static str,
    /// Function that measures the rows.
    pub measure: fn() -> Vec<Row>,
    /// Measured rows.
    pub rows: OnceLock<Vec<Row>>,
}

impl Case {
    /// Measures the rows, unless measured before, and returns them. Panics if an error exceeds its bound.
    pub fn check(&self) -> &[Row] {
        let rows = self.rows.get_or_init(self.measure);
        assert!(!rows.is_empty(), "{}: nothing was measured", self.name);
        for row in rows {
            let Row { backend, kernel, observed, bound, at } = row;
            println!("{}: {backend}, {kernel}: {observed:.2e} of {bound:.1e}, {at}", self.name);
            // Not `>`: a NaN is no success.
            assert!(observed <= bound, "{}: {backend}, {kernel}: {observed:e} > {bound:e}, {at}", self.name);
        }
        rows
    }
}

/// Declares the cases of a section; each case is a test.
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

/// Maths backends, each with its name.
pub const BACKENDS: [(&str, MathBackend); 4] = [
    ("polynomial", MathBackend::Polynomial),
    ("libm", MathBackend::Libm),
    ("micromath", MathBackend::Micromath),
    ("recurrence", MathBackend::Recurrence),
];

/// Returns the kernels that do not round weights.
pub fn exact_kernels() -> impl Iterator<Item = Kernel> {
    Kernel::all().filter(|kernel| !kernel.rounds())
}

/// Returns the instruction sets of this machine.
pub fn isas() -> impl Iterator<Item = Isa> {
    Isa::ALL.into_iter().filter(|isa| isa.available())
}

/// Largest error of those passed to [`Worst::see`].
#[derive(Clone, Debug, Default)]
pub struct Worst {
    /// Largest error; NaN if an error was NaN.
    pub error: f64,
    /// Input with the largest error.
    pub at: String,
}

impl Worst {
    /// Records an error and its input, if the error is the largest so far.
    pub fn see(&mut self, error: f64, at: impl FnOnce() -> String) {
        // A NaN is the worst there is.
        if error > self.error || (error.is_nan() && !self.error.is_nan()) {
            (self.error, self.at) = (error, at());
        }
    }

    /// Returns the table row of this error.
    pub fn row(self, backend: &'static str, kernel: &'static str, bound: f64) -> Row {
        Row { backend, kernel, observed: self.error, bound, at: self.at }
    }
}

/// Returns the cells of a line that are equal on every machine: case, backend, kernels and bound; `None` for a line
/// that is not a row.
pub fn fixed_cells(line: &str) -> Option<[&str; 4]> {
    if !line.starts_with("| ") || line.starts_with("| ---") || line.matches(" | ").count() != 5 {
        return None;
    }
    let cells: Vec<&str> = line.trim_matches(['|', ' ']).split(" | ").collect();
    Some([cells[0], cells[1], cells[2], cells[4]])
}

/// Returns the page with the errors of this run. `old`: the existing page.
pub fn page(sections: &[(&str, &[&Case])], old: &str) -> String {
    let mut page = String::from(HEAD);
    for (title, cases) in sections {
        let mut lines = lines(cases);
        page += &format!("\n## {title}\n\n");
        if *title == ELEMENTARY {
            let mut every = crate::elementary::exhaustive();
            // What took minutes is kept where nothing but the step has changed.
            if let Some(kept) = exhaustive_lines(old).filter(|kept| !every && alike(kept, &lines)) {
                (lines, every) = (kept, true);
            }
            page += if every { EVERY } else { "Of a run with every 1,009th f32 of the domain.\n" };
            page += "\n";
        }
        page +=
            "| case | backend | kernels | worst | bound | where |\n| --- | --- | --- | --- | --- | --- |\n";
        lines.iter().for_each(|line| page += &format!("{line}\n"));
    }
    page
}

/// Returns the table lines of a section.
fn lines(cases: &[&Case]) -> Vec<String> {
    let mut lines = Vec::new();
    for case in cases {
        for Row { backend, kernel, observed, bound, at } in case.check() {
            let what = format!("{}: {}", case.name.replace('_', " "), case.what);
            lines.push(format!("| {what} | {backend} | {kernel} | {observed:.1e} | {bound:.1e} | {at} |"));
        }
    }
    lines
}

/// Returns the lines of elementary functions in a page, if the page was measured with every f32.
fn exhaustive_lines(page: &str) -> Option<Vec<String>> {
    let section = page.split("\n## ").find(|section| section.starts_with(ELEMENTARY))?;
    let lines = || section.lines().filter(|line| fixed_cells(line).is_some_and(|cells| cells[0] != "case"));
    page.contains("run with every f32").then(|| lines().map(String::from).collect())
}

/// Returns whether two lists of lines have equal cases and bounds.
fn alike(a: &[String], b: &[String]) -> bool {
    a.iter().map(|line| fixed_cells(line)).eq(b.iter().map(|line| fixed_cells(line)))
}

/// Title of the section whose cases may take minutes.
pub const ELEMENTARY: &str = "Elementary functions";
const EVERY: &str = "Of a run with every f32 of the domain.\n";

const HEAD: &str = "\
# Numerics

Every case below is a test of its own in `tests/tests/numerics/`, against the f64 oracle of `tests/src/oracle/`.
`worst` is what the run that wrote this page saw on one machine; `bound` is what the test allows. 0 means: no
error at all, or a law that holds without exception.

Written by `NERF_BLESS=numerics cargo test --release -p nerf-tests --test numerics`; the same command without
`NERF_BLESS` checks it. Elementary functions take every 1,009th f32 of their domain, or with `NERF_EXHAUSTIVE=1` every
one; a page that has those of every one keeps them until their cases or bounds change, and whoever changes the
functions themselves runs it again. Laws are checked on inputs that proptest draws, the same in every run, behind those
that once broke them; `PROPTEST_CASES` asks for more.
";

/// Returns the path of the page in the repository.
pub fn path() -> std::path::PathBuf {
    paths::workspace().join("nerf-core/docs/numerics.md")
}

#[test]
fn a_quick_page_keeps_what_took_minutes_until_a_case_changes() {
    let line = |bound: &str| format!("| sin: error | libm | portable | 3.0e-8 | {bound} | 2.5e2, portable |");
    let page = |step: &str| {
        let table =
            "| case | backend | kernels | worst | bound | where |\n| --- | --- | --- | --- | --- | --- |";
        format!(
            "# Numerics\n\n## {ELEMENTARY}\n\n{step}\n{table}\n{}\n\n## Sampling\n\n{table}\n",
            line("1.2e-7")
        )
    };
    let kept = exhaustive_lines(&page(EVERY)).expect("lines");
    assert_eq!(kept, [line("1.2e-7")]);
    assert!(alike(&kept, &[line("1.2e-7").replace("3.0e-8", "2.9e-8")]) && !alike(&kept, &[line("4.0e-7")]));
    assert_eq!(exhaustive_lines(&page("Of a run with every 1,009th f32 of the domain.")), None);
}
