//! Hard cases, each with its tolerance: the tests behind `nerf-core/docs/numerics.md`.

mod elementary;
mod encoding;
mod geometry;
mod network;
mod sampling;
mod table;
mod volume;

/// The page's sections, in the order data flows.
fn sections() -> Vec<(&'static str, &'static [&'static table::Case])> {
    vec![
        ("Elementary functions", elementary::CASES),
        ("Geometry", geometry::CASES),
        ("Sampling", sampling::CASES),
        ("Encoding", encoding::CASES),
        ("Network", network::CASES),
        ("Volume rendering", volume::CASES),
    ]
}

#[test]
fn the_page_names_every_case_with_its_bound() {
    let path = table::path();
    if std::env::var_os("NERF_BLESS").is_some_and(|bless| bless == "numerics") {
        std::fs::write(&path, table::page(&sections())).expect("the page");
    }
    let page = std::fs::read_to_string(&path).expect("nerf-core/docs/numerics.md");
    // Case, backend, tiers and bound of each line; what was seen, and where, differs from machine to machine.
    let mut lines: Vec<[&str; 4]> = Vec::new();
    for line in page.lines().filter(|line| {
        line.starts_with("| ") && !line.starts_with("| ---") && line.matches(" | ").count() == 5
    }) {
        let cells: Vec<&str> = line.trim_matches(['|', ' ']).split(" | ").collect();
        lines.push([cells[0], cells[1], cells[2], cells[4]]);
    }
    let cases = || sections().into_iter().flat_map(|(_, cases)| cases);
    for case in cases() {
        let what = format!("{}: {}", case.name.replace('_', " "), case.what);
        for row in case.check() {
            let line = [&what, row.backend, row.tier, &format!("{:.1e}", row.bound)];
            assert!(lines.contains(&line), "numerics.md has no line {line:?}: NERF_BLESS=numerics renews it");
        }
    }
    let owned = |line: &&[&str; 4]| {
        line[0] == "case"
            || cases().any(|case| line[0] == format!("{}: {}", case.name.replace('_', " "), case.what))
    };
    let strange: Vec<_> = lines.iter().filter(|line| !owned(line)).collect();
    assert!(strange.is_empty(), "no case has measured {strange:?}");
}
