//! The table of worst errors: what each case measured, beside its bound, and `nerf-core/docs/numerics.md`.

use nerf_core::math::MathBackend;
use nerf_core::{Isa, Kernel};
use nerf_tests::paths;
use std::sync::OnceLock;

/// One line of the table.
#[derive(Clone, Debug)]
pub struct Row {
    /// Maths backend, or "any" where none takes part.
    pub backend: &'static str,
    /// Kernels it holds for.
    pub kernel: &'static str,
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
            let Row { backend, kernel, observed, bound, at } = row;
            println!("{}: {backend}, {kernel}: {observed:.2e} of {bound:.1e}, {at}", self.name);
            // Not `>`: a NaN is no success.
            assert!(observed <= bound, "{}: {backend}, {kernel}: {observed:e} > {bound:e}, {at}", self.name);
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

/// The kernels that do not round.
pub fn exact_kernels() -> impl Iterator<Item = Kernel> {
    Kernel::all().filter(|kernel| !kernel.rounds())
}

/// The instruction sets of this machine.
pub fn isas() -> impl Iterator<Item = Isa> {
    Isa::ALL.into_iter().filter(|isa| isa.available())
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
    pub fn row(self, backend: &'static str, kernel: &'static str, bound: f64) -> Row {
        Row { backend, kernel, observed: self.error, bound, at: self.at }
    }
}

/// What of a line stays from machine to machine: case, backend, kernels and bound; `None` of other lines.
pub fn fixed_cells(line: &str) -> Option<[&str; 4]> {
    if !line.starts_with("| ") || line.starts_with("| ---") || line.matches(" | ").count() != 5 {
        return None;
    }
    let cells: Vec<&str> = line.trim_matches(['|', ' ']).split(" | ").collect();
    Some([cells[0], cells[1], cells[2], cells[4]])
}

/// The page, of what this run measures; `old` is the page as it was.
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

/// A section's lines.
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

/// The lines of elementary functions of a page that took every f32.
fn exhaustive_lines(page: &str) -> Option<Vec<String>> {
    let section = page.split("\n## ").find(|section| section.starts_with(ELEMENTARY))?;
    let lines = || section.lines().filter(|line| fixed_cells(line).is_some_and(|cells| cells[0] != "case"));
    page.contains("run with every f32").then(|| lines().map(String::from).collect())
}

/// Whether they are of the same cases and bounds.
fn alike(a: &[String], b: &[String]) -> bool {
    a.iter().map(|line| fixed_cells(line)).eq(b.iter().map(|line| fixed_cells(line)))
}

/// The section whose cases may take minutes.
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
that once broke them; `PROPTEST_CASES` asks for more. The last section says where each hard case of the
list this system was tested against is.
";

/// The page in the repository.
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
