//! What comes from files is text, and is read up to a limit.

use crate::checkpoint::Shape;
use crate::made::{Array, Folder, scene};
use crate::{Ran, blob, command, fails, fit, ok, ran, run};
use nerf_core::blob::{Blob, Body, Content, ParetoFront, Provenance, encoded_len, write};
use serde_json::Value;
use std::path::Path;
use std::time::{Duration, Instant};

/// Moves a cursor, renames a terminal, breaks a line, reads backwards, colours by C1, and is Chinese.
const NAME: &str = "sc\u{1b}[2J\u{1b}]0;x\u{7}e\nforged: n\u{202e}e\u{9b}31m 照片";
/// The same as it is shown.
const SHOWN: &str = r"sc\u{1b}[2J\u{1b}]0;x\u{7}e\nforged: n\u{202e}e\u{9b}31m 照片";

/// Text that may go anywhere: with line ends, and nothing else that acts.
fn assert_tame(what: &str, text: &str) {
    let wild = |c: &char| c.is_control() && !"\n\t".contains(*c) || ('\u{202a}'..='\u{202e}').contains(c);
    assert_eq!(text.chars().find(wild), None, "{what}");
    let forged = text.lines().any(|line| line.starts_with("forged: n"));
    assert!(!forged, "{what}: a name has a line of its own");
}

/// Both streams of a command that must succeed.
fn tame(args: &[&str]) -> Ran {
    let result = run(args);
    assert_eq!(result.code, Some(0), "{args:?}: {}", result.err);
    assert_tame("stdout", &result.out);
    assert_tame("stderr", &result.err);
    result
}

/// Every file of text in a folder; returns how many.
fn tame_files(folder: &str) -> usize {
    let mut count = 0;
    for name in crate::made::names(Path::new(folder)) {
        let path = Path::new(folder).join(&name);
        let text = ["csv", "md", "json", "html", "svg"];
        if path.extension().is_some_and(|ending| text.contains(&ending.to_str().unwrap_or_default())) {
            assert_tame(&name, &std::fs::read_to_string(&path).expect("UTF-8"));
            count += 1;
        }
    }
    count
}

/// The blob of all tests with these words in it.
fn with_words(folder: &Folder, data: &str, made_by: &str, psnr_convention: &str) -> String {
    let bytes = std::fs::read(&blob().1).expect("a blob");
    let old = Blob::open(&bytes).expect("a blob");
    let mut facts = old.scene().expect("a scene").clone();
    facts.occupancy_required = false;
    let body = Body {
        architecture: old.architecture().clone(),
        content: Content::Scene(facts),
        occupancy: None,
        front: ParetoFront::default(),
        proposal: None,
        provenance: Provenance {
            data,
            made_by,
            psnr_convention,
            psnr_db: Some(20.0),
            ..old.provenance().clone()
        },
        weights: old.weights(),
        tables: old.tables(),
    };
    let mut out = vec![0; encoded_len(&body).expect("a body")];
    write(&body, &mut out).expect("a blob");
    folder.file("words.nerf", out)
}

#[test]
fn words_of_a_blob_do_not_act() {
    let folder = Folder::new();
    let file = with_words(&folder, NAME, NAME, NAME);
    let said = tame(&["inspect", &file]).out;
    for name in ["data           ", "made_by        ", "psnr_convention"] {
        assert!(said.contains(&format!("\n{name}       {SHOWN}\n")), "{name}: {said}");
    }
    // A program gets the very words.
    let json = tame(&["inspect", &file, "--json"]).out;
    let object: Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!((&object["data"], &object["psnr_convention"]), (&NAME.into(), &NAME.into()));
    tame(&["explain", &file]);
}

#[cfg(unix)]
#[test]
fn names_of_data_sets_and_views_do_not_act() {
    let folder = Folder::new();
    let data = folder.blender_of(NAME, &scene());
    // One picture of such a name, and one that is missing; a validation view too.
    for split in ["train", "val"] {
        let json = format!("{data}/transforms_{split}.json");
        let mut value: Value = serde_json::from_slice(&std::fs::read(&json).expect("json")).expect("json");
        let name = format!("./{split}/{NAME}");
        std::fs::rename(format!("{data}/{split}/r_0.png"), format!("{data}/{name}.png")).expect("renamed");
        value["frames"][0]["file_path"] = name.into();
        let mut missing = value["frames"][1].clone();
        missing["file_path"] = format!("./nowhere/{NAME}").into();
        value["frames"].as_array_mut().expect("frames").push(missing);
        std::fs::write(&json, value.to_string()).expect("written");
    }
    let (file, report) = (folder.path("a.nerf"), folder.path("report"));
    let args: Vec<&str> = fit(&data, &file, &["--steps", "3", "--report", &report]);
    let said = tame(&args.into_iter().filter(|arg| *arg != "-q").collect::<Vec<_>>());
    assert!(said.err.contains(&format!("{SHOWN}: Blender transforms")), "{}", said.err);
    assert!(said.err.contains(&format!("whose picture is missing: ./nowhere/{SHOWN}")), "{}", said.err);
    assert!(tame_files(&report) >= 4);
    tame(&["inspect", &file]);

    let report = folder.path("evaluated");
    let said = tame(&["eval", &file, &data, "--report", &report]);
    assert!(said.out.contains(r"val/sc\u{1b}[2J"), "{}", said.out);
    assert_eq!(tame_files(&report), 2);
    let json: Value = serde_json::from_str(&tame(&["eval", &file, &data, "--json"]).out).expect("JSON");
    assert_eq!(json["view_scores"][0]["view"], format!("./val/{NAME}"));

    let page = folder.path("shown");
    tame(&["show", &data, "-o", &page, "--rays", "4"]);
    assert_eq!(tame_files(&page), 2);
    let html = std::fs::read_to_string(Path::new(&page).join("show.html")).expect("a page");
    assert!(html.contains(r"sc\u{1b}[2J") && html.contains(r"sc\\u{1b}[2J"), "title and data");

    let report = folder.path("studied");
    let small = ["--repeats", "1", "--timing-views", "1", "--views", "1", "--no-other-occupancy"];
    tame(&[&["study", &file, &data, "--report", &report], &small[..]].concat());
    assert!(tame_files(&report) >= 4);

    // An error names the view on its one line.
    std::fs::write(format!("{data}/train/{NAME}.png"), "no picture").expect("written");
    let said = fails(["eval", &file, &data], &[&format!("train/{SHOWN}.png")]);
    assert_eq!(said.trim_end().lines().count(), 1, "{said:?}");
    assert_tame("stderr", &said);
}

#[test]
fn names_of_arrays_and_tensors_do_not_act() {
    const KEY: &str = "a\u{1b}[2J\u{202e}\n";
    let folder = Folder::new();
    let data = folder.npz_with("a.npz", |arrays| {
        arrays.retain(|array| array.key != "focal");
        arrays.push(Array::new(KEY, "<f8", "()", vec![0; 8]));
    });
    let output = folder.path("a.nerf");
    let said = fails(fit(&data, &output, &[]), &[r"a\u{1b}[2J\u{202e}\n"]);
    assert_tame("stderr", &said);
    let said = fails(["import", &data, "-o", &output], &["images_train", r"a\u{1b}[2J"]);
    assert_tame("stderr", &said);
    let net = folder.path("net.npz");
    Shape::small().checkpoint(1).prefixed(&format!("{KEY}.")).npz(Path::new(&net), "<f4");
    let levels = ["--position-levels", "2", "--direction-levels", "1", "--no-occupancy"];
    let said = tame(&[&["import", &net, "-o", &output], &levels[..]].concat());
    assert!(said.out.contains("prefix              a\\u{1b}[2J\\u{202e}\\n.\n"), "{}", said.out);
}

#[cfg(unix)]
#[test]
fn messages_of_child_processes_do_not_act() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new();
    let script = "#!/bin/sh\ncase \"$*\" in *-encoders*) echo ' V....D libx264 x'; exit 0;; esac\n\
                  cat >/dev/null; printf 'the \\033[2Jsky\\007\\r is \\302\\23331m falling\\n' >&2\nexit 3\n";
    let fake = folder.file("fake", script);
    std::fs::set_permissions(&fake, std::fs::Permissions::from_mode(0o755)).expect("a script");
    let small = ["--orbit", "2", "--width", "8", "--ffmpeg", &fake];
    let mp4 = folder.path("a.mp4");
    let expected = [r"the \u{1b}[2Jsky\u{7}"];
    let said = fails([&["render", &blob().1, "-o", &mp4], &small[..]].concat(), &expected);
    assert_tame("stderr", &said);
}

#[test]
fn pictures_outside_of_the_data_folder_need_a_flag() {
    let folder = Folder::new();
    let data = folder.blender("scene");
    std::fs::rename(format!("{data}/train/r_2.png"), folder.path("secret.png")).expect("moved");
    let json = format!("{data}/transforms_train.json");
    let text = std::fs::read_to_string(&json).expect("json").replace("./train/r_2", "../secret.png");
    std::fs::write(&json, text).expect("written");
    let (file, more) = (folder.path("a.nerf"), ["--steps", "2"]);
    fails(fit(&data, &file, &more), &["transforms_train.json", "`../secret.png`", "--outside-files"]);
    assert!(!Path::new(&file).exists());
    ok(fit(&data, &file, &[&more[..], &["--outside-files"]].concat()));
    fails(["eval", &file, &data], &["--outside-files"]);
    ok(["eval", &file, &data, "-q", "--outside-files"]);
    fails(["show", &data, "-o", &folder.path("shown")], &["--outside-files"]);
}

#[cfg(unix)]
#[test]
fn files_without_end_are_refused_with_their_limit() {
    let folder = Folder::new();
    let data = folder.npz("data.npz");
    let (file, picture) = (folder.path("a.nerf"), folder.path("a.png"));
    let refused = |args: &[&str], words: &[&str]| {
        let start = Instant::now();
        fails(args, words);
        assert!(start.elapsed() < Duration::from_secs(30), "{args:?}: {:?}", start.elapsed());
    };
    let endless = |name: &str| {
        let path = folder.path(name);
        std::os::unix::fs::symlink("/dev/zero", &path).expect("a link");
        path
    };
    let blob_limit = ["/dev/zero", "expected at most 512 MiB, found more"];
    refused(&["inspect", "/dev/zero"], &blob_limit);
    refused(&["render", "/dev/zero", "-o", &picture], &blob_limit);
    refused(&["eval", "/dev/zero", &data], &blob_limit);
    refused(&fit(&endless("zero.json"), &file, &[]), &["zero.json", "at most 256 MiB"]);
    refused(&fit(&endless("zero.npz"), &file, &[]), &["zero.npz", "found a pipe or device"]);
    refused(&fit(&data, &file, &["--config", "/dev/zero"]), &["/dev/zero", "at most 1 MiB"]);
    refused(&["image", "fit", "/dev/zero", "-o", &file], &["/dev/zero", "at most 1 GiB"]);
    refused(&["import", &endless("zero.safetensors"), "-o", &file], &["zero.safetensors", "at most 1 GiB"]);
    endless("a.nerf.checkpoint");
    refused(&fit(&data, &file, &["--resume"]), &["a.nerf.checkpoint", "found a pipe or device"]);
    // A terabyte of nothing is not even begun.
    let sparse = |name: &str| {
        let path = folder.path(name);
        std::fs::File::create(&path).and_then(|file| file.set_len(1 << 40)).expect("a sparse file");
        path
    };
    let terabyte = "found 1099511627776 bytes";
    refused(&["inspect", &sparse("sparse.nerf")], &["sparse.nerf", "512 MiB", terabyte]);
    refused(&fit(&sparse("sparse.json"), &file, &[]), &["sparse.json", "256 MiB", terabyte]);
    refused(&["image", "fit", &sparse("sparse.jpg"), "-o", &file], &["sparse.jpg", "1 GiB", terabyte]);
    refused(&fit(&sparse("sparse.npz"), &file, &[]), &["sparse.npz"]);
    let scene = folder.blender("scene");
    std::fs::remove_file(format!("{scene}/train/r_1.png")).expect("removed");
    sparse("scene/train/r_1.png");
    refused(&fit(&scene, &file, &[]), &["r_1.png", "1 GiB", terabyte]);
}

#[cfg(unix)]
#[test]
fn a_blob_may_come_through_a_pipe() {
    let (_, file) = blob();
    let folder = Folder::new();
    let pipe = folder.path("pipe");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status().expect("mkfifo");
    assert!(made.success());
    let piped = |args: &[&str]| {
        let (pipe, bytes) = (pipe.clone(), std::fs::read(file).expect("a blob"));
        let writer = std::thread::spawn(move || std::fs::write(pipe, bytes).expect("read to its end"));
        let said = ok(args);
        writer.join().expect("written");
        said
    };
    let plain = ok(["inspect", file]);
    assert_eq!(piped(&["inspect", &pipe]), plain.replace(file, &pipe));
    let pictures = [folder.path("a.png"), folder.path("b.png")];
    ok(["render", file, "-q", "-o", &pictures[0], "--width", "8"]);
    piped(&["render", &pipe, "-q", "-o", &pictures[1], "--width", "8"]);
    let [a, b] = pictures.map(|path| std::fs::read(path).expect("a picture"));
    assert!(a == b);
    // Standard input; and what is no blob, or none at all.
    let read = |input: std::process::Stdio| ran(command(["inspect", "/dev/stdin"]).stdin(input));
    let said = read(std::fs::File::open(file).expect("a blob").into());
    assert_eq!((said.code, said.out), (Some(0), plain.replace(file, "/dev/stdin")));
    let empty = read(std::process::Stdio::null());
    assert!(empty.code == Some(1) && empty.err.contains("/dev/stdin"), "{}", empty.err);
    let mut yes =
        std::process::Command::new("yes").stdout(std::process::Stdio::piped()).spawn().expect("yes");
    let endless = read(yes.stdout.take().expect("piped").into());
    assert!(endless.code == Some(1) && endless.err.contains("at most 512 MiB"), "{}", endless.err);
    // It ends when nobody reads it.
    let _ = yes.wait();
}
