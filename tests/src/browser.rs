//! A headless browser, for pages that run without a user.

use crate::tools;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns the first Chromium found: `$CHROMIUM`, or one in `PATH`. Records the test as skipped, as [`tools::there_is`]
/// does, if there is no Chromium.
///
/// # Panics
/// As [`tools::there_is`].
pub fn chromium() -> Option<PathBuf> {
    let named = std::env::var_os("CHROMIUM").map(PathBuf::from);
    let path = std::env::var_os("PATH").unwrap_or_default();
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let in_path = std::env::split_paths(&path).flat_map(|folder| names.map(|name| folder.join(name)));
    let found = named.into_iter().chain(in_path).find(|program| program.is_file());
    let here = tools::there_is("chromium", found.is_some());
    found.filter(|_| here)
}

/// Loads the page `address#hash` and returns its document as HTML. Writes an image of the window to `screenshot`, and
/// the browser's profile to `folder`.
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

/// Returns the value of the attribute `data-<name>` of the document's body.
pub fn noted<'d>(document: &'d str, name: &str) -> &'d str {
    let body = document.split("<body").nth(1).and_then(|rest| rest.split('>').next()).expect("a body");
    let value = body.split(&format!("data-{name}=\"")).nth(1).and_then(|rest| rest.split('"').next());
    value.unwrap_or_else(|| panic!("no data-{name}: {body}"))
}

/// Returns the parsed JSON that the page wrote into the element with this id.
pub fn left(document: &str, id: &str) -> serde_json::Value {
    let place = document.split(&format!("id=\"{id}\">")).nth(1).and_then(|rest| rest.split('<').next());
    let text = place.unwrap_or_else(|| panic!("no {id} in the document"));
    serde_json::from_str(text).expect("JSON")
}
