//! The demo's scene with poses that are folded on purpose, and what `check` says of it, as a page.
//!
//! `cargo run --release -p nerf-train --example folded` writes out/folded.html.

use nerf_train::capture::check::Diagnosis;
use nerf_train::data::demo::two_rounds;
use nerf_train::show::cameras::{checked, page};
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let mut dataset = two_rounds(true)?;
    let diagnosis = Diagnosis::of(&dataset);
    diagnosis.lines().for_each(|line| println!("{line}"));
    std::fs::create_dir_all("out")?;
    std::fs::write("out/folded.html", page::page(&checked(&mut dataset, &diagnosis, (None, None))?)?)?;
    println!("out/folded.html");
    Ok(())
}
