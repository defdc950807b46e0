//! The web element from its npm package, in pages that contain only its tag.

use super::web::{Server, build_page};
use nerf_testing::browser::{chromium, document, noted};
use nerf_testing::scenes::Recipe;
use nerf_testing::tools::all_here;
use nerf_testing::{build, paths};
use std::path::{Path, PathBuf};
use std::process::Command;

const MODULE: &str = "<script type=\"module\" src=\"node_modules/nerf-view/nerf-view.js\"></script>";
const WRONG: [&str; 3] = ["missing.nerf", "damaged.nerf", "picture.nerf"];
/// Number of attempts, at least one of which must not stutter: other programs can delay a thread.
const TURNS: usize = 5;
/// Script that records each worker, and whether the worker was terminated.
const NOTING: &str = "<script>
    var noted = [];
    Worker = class extends Worker {
        ended = false;
        constructor(...all) { super(...all); noted.push(this); }
        terminate() { super.terminate(); this.ended = true; }
    };
</script>";

/// Fills `folder` with the package as npm installs it, scenes and pages. Returns the path of a browser; `None` if a
/// tool is missing.
fn site(folder: &Path) -> Option<PathBuf> {
    if !all_here(&["npm", "python3"]) || !build_page(&[Path::new("--package"), folder]) {
        return None;
    }
    let version = env!("CARGO_PKG_VERSION");
    let package = format!("./nerf-view-{version}.tgz");
    let mut npm = Command::new("npm");
    build::run(npm.args(["install", "--offline", "--silent", &package]).current_dir(folder));

    let put = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("a temporary file");
    let blob = Recipe::LEARNED.blob();
    put("scene.nerf", &blob);
    let mut damaged = blob;
    *damaged.last_mut().expect("bytes") ^= 1;
    put("damaged.nerf", &damaged);
    put("picture.nerf", &Recipe::PICTURE.blob());

    let scene = "<nerf-view src=\"scene.nerf\" controls></nerf-view>";
    let page = |name: &str, body: &str| put(name, format!("<!DOCTYPE html>\n{body}\n").as_bytes());
    page("one.html", &format!("{MODULE}\n{scene}"));
    page(
        "two.html",
        &format!("{MODULE}\n{scene}\n{}", scene.replace("controls", "output=\"depth\" controls")),
    );
    let wrong = WRONG.map(|name| scene.replace("scene.nerf", name));
    page("wrong.html", &format!("{MODULE}\n{}", wrong.join("\n")));
    page("old.html", &format!("<script>WebAssembly.validate = () => false;</script>\n{MODULE}\n{scene}"));
    page("gone.html", &format!("{NOTING}\n{MODULE}\n{scene}"));
    put("element.html", include_bytes!("element.html"));
    chromium()
}

#[test]
fn the_element_draws_in_a_page_with_nothing_but_its_tag() {
    let folder = paths::temporary();
    let Some(browser) = site(folder.path()) else { return };
    let server = Server::of(folder.path());
    let address = format!("{}element.html", server.address);
    let tried = |page: &str| {
        let profile = paths::temporary();
        let screenshot = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("element-{page}.png"));
        let document = document(&browser, profile.path(), &address, page, &screenshot);
        assert_eq!(noted(&document, "selftest"), "passed", "{page}");
        document
    };
    tried("gone");
    let wrong = tried("wrong");
    let said: Vec<&str> = noted(&wrong, "said").split(" | ").collect();
    let expected = [
        "scene.nerf: this browser has no WebAssembly SIMD",
        "missing.nerf: cannot be loaded: the server answers 404",
        "damaged.nerf: CRC-32: expected",
        "picture.nerf: expected a scene, found a picture",
    ];
    assert_eq!(said.len(), expected.len(), "{said:?}");
    for (said, expected) in said.iter().zip(expected) {
        assert!(said.starts_with(expected), "expected {expected}, found {said}");
    }
    for page in ["one", "two"] {
        // What blocks the page does so each time.
        let stutters: Vec<String> = (0..TURNS)
            .map(|_| noted(&tried(page), "stutters").to_owned())
            .take_while(|long| !long.is_empty())
            .collect();
        assert!(stutters.len() < TURNS, "{page}: tasks of the page's thread above 50 ms: {stutters:?} ms");
    }
}
