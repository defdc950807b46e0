//! Hard cases, each with its tolerance: the tests behind `nerf-core/docs/numerics.md`.

mod elementary;
mod encoding;
mod table;
mod volume;

/// The page's sections, in the order data flows.
fn sections() -> Vec<(&'static str, &'static [&'static table::Case])> {
    vec![
        ("Elementary functions", elementary::CASES),
        ("Encoding", encoding::CASES),
        ("Volume rendering", volume::CASES),
    ]
}

#[test]
fn the_page_names_every_case_with_its_bound() {
    let path = table::path();
    if std::env::var_os("NERF_BLESS").is_some() {
        std::fs::write(&path, table::page(&sections())).expect("the page");
    }
    let page = std::fs::read_to_string(&path).expect("nerf-core/docs/numerics.md");
    for case in sections().into_iter().flat_map(|(_, cases)| cases) {
        let what = format!("| {}: {} |", case.name.replace('_', " "), case.what);
        for row in case.check() {
            let line = format!("{what} {} | {} |", row.backend, row.tier);
            let bound = format!("| {:.1e} |", row.bound);
            let found = page.lines().any(|found| found.starts_with(&line) && found.contains(&bound));
            assert!(found, "numerics.md has no line {line} with {bound}: NERF_BLESS=1 renews it");
        }
    }
}
