//! Difficult numerical cases, each with its tolerance: the tests behind `nerf-core/docs/numerics.md`.

mod blob;
mod cameras;
mod contraction;
mod elementary;
mod encoding;
mod frame;
mod geometry;
mod gradient;
mod network;
mod property;
mod sampling;
mod table;
mod volume;
mod walk;

/// Returns the sections of the page, in the order of the data flow.
fn sections() -> Vec<(&'static str, &'static [&'static table::Case])> {
    vec![
        (table::ELEMENTARY, elementary::CASES),
        ("Rays and boxes", geometry::CASES),
        ("Cameras and lenses", cameras::CASES),
        ("Unbounded space", contraction::CASES),
        ("The occupancy grid", walk::CASES),
        ("Sampling", sampling::CASES),
        ("Sampling: laws", sampling::LAWS),
        ("Encoding", encoding::CASES),
        ("Encoding: learned grids and spherical harmonics", encoding::GRID),
        ("Encoding: laws", encoding::LAWS),
        ("Encoding: domain", encoding::DOMAIN),
        ("Network", network::CASES),
        ("Network: activations", network::ACTIVATIONS),
        ("Network: gradients", gradient::CASES),
        ("Volume rendering", volume::CASES),
        ("Volume rendering: laws", volume::LAWS),
        ("Frames", frame::CASES),
        ("Frames of hostile networks", frame::HOSTILE),
        ("Frames of next to nothing", frame::FAINT),
    ]
}

#[test]
fn the_page_names_every_case_with_its_bound() {
    let path = table::path();
    if std::env::var_os("NERF_BLESS").is_some_and(|bless| bless == "numerics") {
        let old = std::fs::read_to_string(&path).unwrap_or_default();
        let page = table::page(&sections(), &old);
        std::fs::write(&path, page).expect("the page");
    }
    let page = std::fs::read_to_string(&path).expect("nerf-core/docs/numerics.md");
    // What was seen, and where, differs from machine to machine.
    let lines: Vec<[&str; 4]> = page.lines().filter_map(table::fixed_cells).collect();
    let cases = || sections().into_iter().flat_map(|(_, cases)| cases);
    for case in cases() {
        let what = format!("{}: {}", case.name.replace('_', " "), case.what);
        for row in case.check() {
            let line = [&what, row.backend, row.kernel, &format!("{:.1e}", row.bound)];
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
