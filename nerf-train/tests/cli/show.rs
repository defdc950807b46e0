//! `show`: its files, its errors, and its page in a browser.

use crate::browser::{chromium, noted};
use crate::made::Folder;
use crate::{fails, json, ok};
use std::path::Path;
use std::process::Command;

/// A scene in a folder of its own, shown with some arguments.
fn show(folder: &Folder, more: &[&str]) -> String {
    let (data, output) = (folder.npz("scene <b>&.npz"), folder.path("shown"));
    ok([&["show", &data, "-o", &output, "-q", "--rays", "12"], more].concat());
    output
}

#[test]
fn show_writes_page_and_summary() {
    let folder = Folder::new();
    let output = show(&folder, &[]);
    assert_eq!(folder.names(), ["scene <b>&.npz", "shown"]);
    let summary = json(Path::new(&output).join("summary.json"));
    assert_eq!((&summary["cameras"], &summary["rays_shown"]), (&6.into(), &12.into()));
    assert!(summary["live_samples_shown"].as_u64() > Some(0));

    let again = show(&folder, &["--camera", "5", "--split", "train", "--up=-y", "--frustum", "0.3"]);
    let summary = json(Path::new(&again).join("summary.json"));
    assert_eq!((&summary["cameras"], &summary["camera"]), (&1.into(), &5.into()));
    assert_eq!(summary["up"], serde_json::json!([0.0, -1.0, 0.0]));
}

#[test]
fn the_same_seed_and_step_show_the_same_rays() {
    let page = |more: &[&str]| {
        let folder = Folder::new();
        std::fs::read_to_string(Path::new(&show(&folder, more)).join("show.html")).expect("a page")
    };
    let first = page(&["--step", "7", "--seed", "3"]);
    assert_eq!(first, page(&["--step", "7", "--seed", "3", "--threads", "1"]));
    assert_ne!(first, page(&["--step", "8", "--seed", "3"]));
    assert_ne!(first, page(&["--step", "7", "--seed", "4"]));
}

#[test]
fn wrong_flags_of_show_are_named() {
    let folder = Folder::new();
    let (data, output) = (folder.npz("scene.npz"), folder.path("shown"));
    let with = |more: &[&str], words: &[&str]| {
        fails([&["show", &data, "-o", &output, "-q"], more].concat(), words);
    };
    with(&["--camera", "6"], &["--camera", "less than 6", "found 6"]);
    with(&["--camera", "2", "--split", "val"], &["--camera", "less than 2", "val"]);
    with(&["--split", "test"], &["--split", "test"]);
    for (flag, value) in [("--rays", "0"), ("--samples", "0"), ("--frustum", "-1"), ("--up", "w")] {
        with(&[&format!("{flag}={value}")], &[flag]);
    }
    with(&["--near", "5", "--far", "2"], &["near"]);
    // Found before the data is read.
    let taken = folder.file("taken", "a file");
    fails(["show", "nowhere.npz", "-o", &taken], &["taken"]);
    std::fs::create_dir_all(Path::new(&output).join("show.html")).expect("a folder");
    with(&[], &["show.html", "folder"]);
}

/// The page's document after it has driven itself (`#selftest`); `None` without a browser.
fn driven(folder: &Folder, page: &Path) -> Option<String> {
    let output = Command::new(chromium()?)
        .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"])
        .args(["--window-size=1000,700", "--virtual-time-budget=20000", "--dump-dom"])
        .arg(format!("--user-data-dir={}", folder.path("browser")))
        .arg(format!("file://{}#selftest", page.display()))
        .output()
        .expect("the browser starts");
    Some(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[test]
fn the_page_draws_and_turns_in_a_browser() {
    for (more, cameras) in [(&[][..], "6"), (&["--camera", "3"], "1")] {
        let folder = Folder::new();
        let output = show(&folder, more);
        let Some(document) = driven(&folder, &Path::new(&output).join("show.html")) else { return };
        assert_eq!(noted(&document, "ready"), "true");
        assert_eq!(noted(&document, "errors"), "0", "{document:.400}");
        assert_eq!(noted(&document, "selftest"), "passed");
        assert_eq!([noted(&document, "cameras"), noted(&document, "images")], [cameras; 2]);
        assert_eq!(noted(&document, "rays"), "12");
        assert!(noted(&document, "live").parse::<u32>().expect("a number") > 0);
        assert!(noted(&document, "ink").parse::<f32>().expect("a number") > 0.005);
        assert!(document.contains("scene &lt;b&gt;&amp;"), "the scene's name is text");
    }
}

#[test]
fn a_broken_page_is_noticed() {
    let folder = Folder::new();
    let page = Path::new(&show(&folder, &[])).join("show.html");
    let text = std::fs::read_to_string(&page).expect("a page");
    let broken = [
        ("view.turn(dx, dy);", ";", "failed: drag turns"),
        ("data:image/jpeg;base64,/9j/", "data:image/jpeg;base64,AAAA", ""),
    ];
    for (from, to, word) in broken {
        assert!(text.contains(from));
        std::fs::write(&page, text.replace(from, to)).expect("written");
        let Some(document) = driven(&folder, &page) else { return };
        match word {
            "" => assert!(noted(&document, "errors") != "0" && noted(&document, "ready") == "false"),
            word => assert!(noted(&document, "selftest").contains(word)),
        }
    }
}
