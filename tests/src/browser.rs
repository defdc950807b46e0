//! A browser without a window, for pages that drive themselves.

use crate::tools;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The first Chromium that is there: `$CHROMIUM`, or one in `PATH`; without one the test is left out.
///
/// # Panics
/// As [`tools::there_is`].
pub fn chromium() -> Option<PathBuf> {
    let named = std::env::var_os("CHROMIUM").map(PathBuf::from);
    let path = std::env::var_os("PATH").unwrap_or_default();
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let in_path = std::env::split_paths(&path).flat_map(|folder| names.map(|name| folder.join(name)));
    let found = named.into_iter().chain(in_path).find(|program| program.is_file());
    tools::there_is("chromium", found.is_some());
    found
}

/// The document of a page at an address once it is loaded, and a picture of the window in `screenshot`; the browser's
/// profile lies in `folder`.
pub fn document(browser: &Path, folder: &Path, address: &str, hash: &str, screenshot: &Path) -> String {
    let output = Command::new(browser)
        .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"])
        .args(["--window-size=1000,700", "--timeout=120000", "--dump-dom"])
        .arg(format!("--screenshot={}", screenshot.display()))
        .arg(format!("--user-data-dir={}", folder.join("browser").display()))
        .arg(format!("{address}#{hash}"))
        .output()
        .expect("the browser starts");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The value of `data-<name>` of the document's body.
pub fn noted<'d>(document: &'d str, name: &str) -> &'d str {
    let body = document.split("<body").nth(1).and_then(|rest| rest.split('>').next()).expect("a body");
    let value = body.split(&format!("data-{name}=\"")).nth(1).and_then(|rest| rest.split('"').next());
    value.unwrap_or_else(|| panic!("no data-{name}: {body}"))
}

/// What the page left as JSON under an id.
pub fn left(document: &str, id: &str) -> serde_json::Value {
    let place = document.split(&format!("id=\"{id}\">")).nth(1).and_then(|rest| rest.split('<').next());
    let text = place.unwrap_or_else(|| panic!("no {id} in the document"));
    serde_json::from_str(text).expect("JSON")
}
