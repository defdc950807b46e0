//! Poses of bare photographs: with a COLMAP of shell, and with the real one where there is one.

use crate::made::{Folder, names};
use crate::stopping::Running;
use crate::tools;
use crate::{Ran, command, fails, fit, fit_grid, interruptible, ok, ran, read_picture, write_picture};
use rayon::prelude::*;
use std::fs;
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

/// Writes down what it is asked for, does what `$FAKE` says at the stage `$AT`, and copies models that are there already.
const FAKE: &str = r#"#!/bin/sh
here=$(dirname "$0")
[ "$2$AT" = --helphelp ] && exec sleep 1000
[ "$2" = --help ] && { echo "COLMAP 9.1 (Commit 1)"; echo "--FeatureExtraction.use_gpu arg (=1)
--Mapper.init_image_id1 arg (=-1) --Mapper.min_num_matches arg (=15) --SiftMatching.max_ratio arg (=0.8)"; exit 0; }
echo "$QT_QPA_PLATFORM $*" >> "$here/asked"
echo 'Processed file [2/4]'
echo '  junk' >&2
[ "$1" = "$AT" ] && eval "$FAKE"
[ "$1" = feature_extractor ] && : > "$5"
[ "$1" = mapper ] || exit 0
while [ "$1" != --output_path ]; do shift; done
cp -r "$here"/models/* "$2"
"#;

/// Photographs `a b.jpg`, `1.png`, `2.png`, `3.png` in `photos`, and the fake with the models of some of them.
struct World {
    folder: Folder,
    photos: String,
}

impl World {
    fn new() -> Self {
        let folder = Folder::new();
        let photos = folder.path("photos");
        fs::create_dir(&photos).expect("a folder");
        for (i, name) in ["a b.jpg", "1.png", "2.png", "3.png"].into_iter().enumerate() {
            let pixel = |x: u32, y: u32| image::Rgb([(20 * x) as u8, (30 * y) as u8, i as u8]);
            write_picture(image::RgbImage::from_fn(8, 6, pixel), Path::new(&photos).join(name));
        }
        fs::write(Path::new(&photos).join("notes.txt"), "not a picture").expect("written");
        fs::create_dir(folder.path("bin")).expect("a folder");
        let fake = folder.file("bin/colmap", FAKE);
        fs::set_permissions(&fake, fs::Permissions::from_mode(0o755)).expect("a script");
        let world = Self { folder, photos };
        world.model(0, &["2.png"]);
        world.model(1, &["a b.jpg", "1.png", "3.png"]);
        world
    }

    /// A model, as text, of these photographs: side by side, two points with errors of 0.5 and 1 pixels.
    fn model(&self, number: usize, names: &[&str]) {
        self.model_in(&format!("bin/models/{number}"), names);
    }

    fn model_in(&self, folder: &str, names: &[&str]) {
        let folder = self.folder.path(folder);
        fs::create_dir_all(&folder).expect("a folder");
        let write = |name: &str, text: String| fs::write(format!("{folder}/{name}"), text).expect("written");
        write("cameras.txt", "1 OPENCV 8 6 10 10 4 3 0 0 0 0\n".into());
        let image = |(i, name): (usize, &&str)| format!("{} 1 0 0 0 {i} 0 0 1 {name}\n4 3 1\n", i + 1);
        write("images.txt", names.iter().enumerate().map(image).collect());
        write("points3D.txt", "1 0 0 3 9 9 9 0.5 1 0\n2 1 0 3 9 9 9 1 1 0\n".into());
        write("project.ini", "image_path=hidden".into());
    }

    fn path(&self) -> String {
        format!("{}:{}", self.folder.path("bin"), std::env::var("PATH").unwrap_or_default())
    }

    /// `poses` with this COLMAP, which does `what` at a stage.
    fn poses(&self, more: &[&str], at: &str, what: &str) -> Ran {
        let args = [&["poses", self.photos.as_str()], more].concat();
        ran(command(args).env("PATH", self.path()).env("AT", at).env("FAKE", what))
    }

    /// That a command failed in one line that holds these words, and left nothing.
    fn refused(&self, ran: &Ran, words: &[&str]) {
        assert_eq!(ran.code, Some(1), "{}", ran.err);
        let line = ran.err.lines().last().expect("an error");
        assert!(line.starts_with("error: ") && words.iter().all(|word| line.contains(word)), "{}", ran.err);
        self.is_as_it_was();
    }

    fn is_as_it_was(&self) {
        assert_eq!(self.folder.names(), ["bin", "photos"]);
        assert_eq!(names(Path::new(&self.photos)), ["1.png", "2.png", "3.png", "a b.jpg", "notes.txt"]);
    }
}

#[test]
fn photographs_alone_are_told_how_to_get_poses_and_that_is_how() {
    let world = World::new();
    let told = ran(&mut command(fit(&world.photos, &world.folder.path("a.nerf"), &[])));
    let words = ["found 4 photographs and no poses", "`nerf-train poses ", "single_camera 1 --Sift"];
    world.refused(&told, &words);
    let (_, by_hand) = told.err.split_once("By hand: ").expect("commands");
    let (by_hand, _) = by_hand.split_once(" (since").expect("their end");
    let mut shell = Command::new("sh");
    shell.args(["-c", by_hand]).env("PATH", world.path()).env("AT", "").env("FAKE", "");
    assert!(shell.status().expect("sh").success(), "{by_hand}");
    let more = ["--near", "1", "--far", "4", "--steps", "2"];
    ok(fit(&world.photos, &world.folder.path("a.nerf"), &more));
    // Elsewhere nothing is said of COLMAP's commands.
    fs::create_dir(world.folder.path("empty")).expect("a folder");
    fails(fit(&world.folder.path("empty"), &world.folder.path("b.nerf"), &[]), &["not a data set"]);
}

#[test]
fn poses_makes_a_folder_to_fit_and_only_reads_the_photographs() {
    let world = World::new();
    let made = world.poses(&[], "", "");
    assert_eq!(made.code, Some(0), "{}", made.err);
    let folder = world.folder.path("photos_poses");
    for (field, value) in [
        ("folder", &*folder),
        ("photographs", "4"),
        ("registered", "3"),
        ("unregistered", "2.png"),
        ("models", "2"),
        ("points", "2"),
        ("mean_reprojection_error_px", "0.75"),
        ("way", "all photographs against all"),
    ] {
        assert!(crate::has(&made.out, field, value), "{field}: {}", made.out);
    }
    let fault = "torn: photographs are missing in it; take more between those that have a pose and those that have none";
    assert!(crate::has(&made.out, "fault", fault), "{}", made.out);
    assert_eq!(names(Path::new(&folder)), ["images", "sparse"]);
    assert_eq!(names(&Path::new(&folder).join("images")), ["1.png", "2.png", "3.png", "a b.jpg"]);
    let sparse = Path::new(&folder).join("sparse");
    assert_eq!(names(&sparse), ["0"]);
    assert_eq!(names(&sparse.join("0")), ["cameras.txt", "images.txt", "points3D.txt"]);
    let original = fs::read(format!("{}/a b.jpg", world.photos)).expect("there");
    assert_eq!(fs::read(format!("{folder}/images/a b.jpg")).expect("there"), original);
    fs::OpenOptions::new()
        .append(true)
        .open(format!("{folder}/images/a b.jpg"))
        .expect("there")
        .write_all(b"x")
        .expect("room");
    assert_eq!(fs::read(format!("{}/a b.jpg", world.photos)).expect("there"), original, "a link, not a copy");
    let asked = fs::read_to_string(world.folder.path("bin/asked")).expect("what was asked for");
    let asked: Vec<&str> = asked.lines().collect();
    // What is torn is tried in the next ways, too.
    let stages = [
        "feature_extractor",
        "exhaustive_matcher",
        "mapper",
        "sequential_matcher",
        "mapper",
        "mapper",
        "exhaustive_matcher",
        "mapper",
    ];
    assert!(
        asked.len() == stages.len()
            && asked.iter().zip(stages).all(|(line, stage)| line.starts_with(&format!("offscreen {stage} ")))
    );
    let newer =
        "--ImageReader.camera_model OPENCV --ImageReader.single_camera 1 --FeatureExtraction.use_gpu 0";
    assert!(asked[0].ends_with(newer), "{asked:?}");
    assert!(
        asked[5].ends_with("--Mapper.init_image_id1 3") && asked[7].ends_with("--Mapper.min_num_matches 30")
    );
    ok(fit(&folder, &world.folder.path("a.nerf"), &["--near", "1", "--far", "4", "--steps", "2"]));

    // A second time there is something of that name.
    let again = world.poses(&[], "", "");
    assert!(again.code == Some(1) && again.err.contains("it is there already"), "{}", again.err);
    let other = world.folder.path("new/other");
    let json = world.poses(&["-o", &other, "--json", "--sequential", "--threads", "2"], "", "");
    let said: serde_json::Value = serde_json::from_str(&json.out).expect("one object");
    assert_eq!((said["photographs"].as_u64(), said["registered"].as_u64()), (Some(4), Some(3)), "{said}");
    assert_eq!(said["mean_reprojection_error_px"].as_f64(), Some(0.75));
    assert_eq!(said["unregistered"], serde_json::json!(["2.png"]));
    let last = fs::read_to_string(world.folder.path("bin/asked")).expect("what was asked for");
    assert!(last.contains("sequential_matcher") && last.contains("--Mapper.num_threads 2"), "{last}");
}

#[test]
fn a_torn_model_is_replaced_by_that_of_the_next_way() {
    let world = World::new();
    world.model_in("bin/whole/1", &["a b.jpg", "1.png", "2.png", "3.png"]);
    let whole = "case \"$*\" in *sequential.db*) rm -r \"$here\"/models/*; cp -r \"$here\"/whole/* \"$here/models\";; esac";
    let made = world.poses(&[], "mapper", whole);
    assert_eq!(made.code, Some(0), "{}", made.err);
    assert!(made.err.contains("all photographs against all: 3 of 4 photographs: torn"), "{}", made.err);
    assert!(crate::has(&made.out, "registered", "4"), "{}", made.out);
    assert!(made.out.contains("each photograph against its neighbours"), "{}", made.out);
    assert!(!made.out.contains("fault"), "{}", made.out);
    let asked = fs::read_to_string(world.folder.path("bin/asked")).expect("what was asked for");
    assert_eq!(asked.lines().count(), 5, "{asked}");
}

#[test]
fn two_captures_in_one_folder_are_named() {
    let world = World::new();
    let pixel = |x: u32, y: u32| image::Rgb([(20 * x) as u8, (30 * y) as u8, 9]);
    for name in ["x1.png", "x2.png", "x3.png"] {
        write_picture(image::RgbImage::from_fn(6, 8, pixel), Path::new(&world.photos).join(name));
    }
    world.model(0, &["x1.png", "x2.png", "x3.png"]);
    world.model(1, &["a b.jpg", "1.png", "2.png", "3.png"]);
    let made = world.poses(&["--json"], "", "");
    let said: serde_json::Value = serde_json::from_str(&made.out).expect("one object");
    let fault = said["fault"].as_str().expect("a fault");
    assert!(["torn", "x1.png, x2.png, x3.png", "two captures"].iter().all(|w| fault.contains(w)), "{fault}");
    // Each size has a camera of its own, of which the features are found by list.
    assert_eq!(said["cameras"], 2, "{said}");
    let asked = fs::read_to_string(world.folder.path("bin/asked")).expect("what was asked for");
    let lists =
        asked.lines().filter(|line| line.contains("--image_list_path") && line.contains("single_camera 1"));
    assert_eq!(lists.count(), 2, "{asked}");
}

#[test]
fn without_poses_nothing_is_left() {
    let world = World::new();
    let missing = ran(command(["poses", &world.photos]).env("PATH", ""));
    world.refused(&missing, &["no colmap found", "apt-get install colmap"]);
    let failed = world.poses(&[], "exhaustive_matcher", "echo 'the sky is falling' >&2; exit 3");
    world.refused(&failed, &["colmap exhaustive_matcher failed", "exit status: 3", "the sky is falling"]);
    let hangs = world.poses(&["--patience", "0.05"], "exhaustive_matcher", "exec sleep 1000");
    world
        .refused(&hangs, &["colmap exhaustive_matcher has said nothing for 3 s and was ended", "--patience"]);
    let mute = world.poses(&["--patience", "0.02"], "help", "");
    world.refused(&mute, &["colmap feature_extractor has said nothing", "--patience"]);
    let other = "echo \"ERROR: Failed to parse options - unrecognised option '--ImageReader.single_camera'.\" >&2; exit 1";
    let other = world.poses(&[], "feature_extractor", other);
    world.refused(&other, &["this colmap (9.1)", "versions 3.6 to 4", "--ImageReader.single_camera"]);
    let nothing = world.poses(&["--patience=-1"], "", "");
    world.refused(&nothing, &["--patience", "expected a number of minutes"]);
    let killed = world.poses(&[], "mapper", "kill -9 $$");
    world.refused(&killed, &["colmap mapper failed", "signal: 9"]);
    let none = "echo '=> No good initial image pair found.'; echo 'ERROR: failed to create sparse model' >&2; exit 1";
    world.refused(&world.poses(&[], "mapper", none), &["registered none of 4", "No good initial image pair"]);
    world.refused(&world.poses(&[], "mapper", "exit 0"), &["registered none of 4"]);
    let damaged = "rm -r \"$here/models/1\"; echo 9 > \"$here/models/0/cameras.txt\"";
    world.refused(&world.poses(&[], "mapper", damaged), &["cameras.txt"]);
    let inside = world.poses(&["-o", &format!("{}/made", world.photos)], "", "");
    world.refused(&inside, &["-o", "which is being read"]);
    let file = world.poses(&["-o", "made.nerf"], "", "");
    world.refused(&file, &["-o", "the name of a folder"]);

    let few = world.folder.path("few");
    fs::create_dir(&few).expect("a folder");
    let of_few = || ran(command(["poses", &few]).env("PATH", world.path()));
    let starts = |ran: &Ran, words: &[&str]| {
        assert_eq!(ran.code, Some(1));
        assert!(words.iter().all(|word| ran.err.contains(word)), "{}", ran.err);
    };
    starts(&of_few(), &["few", "at least 3 photographs, found 0"]);
    for name in ["1.png", "2.png"] {
        fs::copy(format!("{}/{name}", world.photos), format!("{few}/{name}")).expect("copied");
    }
    fs::write(format!("{few}/3.png"), "no picture").expect("written");
    starts(&of_few(), &["at least 3 photographs, found 2", "1 files that are no whole pictures"]);
    fs::write(format!("{few}/4.heic"), b"\0\0\0\x18ftypheic").expect("written");
    starts(&of_few(), &["4.heic", "HEIC", "heif-convert"]);
    starts(&ran(&mut command(["poses", "nowhere"])), &["nowhere: no such file"]);
    assert_eq!(world.folder.names(), ["bin", "few", "photos"]);
}

#[test]
fn a_signal_ends_colmap_and_leaves_nothing() {
    let world = World::new();
    for signal in ["INT", "TERM"] {
        let mut poses = interruptible(["poses", &world.photos, "--json"]);
        let busy = "touch \"$here/busy\"; while :; do echo x > \"$(dirname \"$3\")/$$\"; sleep 0.01; done";
        poses.env("PATH", world.path()).env("AT", "exhaustive_matcher").env("FAKE", busy);
        let mut running = Running::of(&mut poses);
        let mark = PathBuf::from(world.folder.path("bin/busy"));
        crate::stopping::wait_for(&mark, &mut running);
        fs::remove_file(&mark).expect("it is there");
        let begun = Instant::now();
        running.signal(signal);
        let output = running.output();
        assert!(begun.elapsed() < Duration::from_secs(2), "{:?}", begun.elapsed());
        assert!(matches!(output.status.code(), Some(130 | 143)), "{:?}", output.status);
        let said: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one object");
        assert_eq!(said["error"], "interrupted; nothing is written");
        world.is_as_it_was();
        // A process that was killed may be seen for a moment longer.
        let left = || crate::signals::processes_with(&world.folder.path("bin"));
        while !left().is_empty() && begun.elapsed() < Duration::from_secs(10) {
            std::thread::sleep(Duration::from_millis(20));
        }
        let running = left();
        assert!(running.is_empty(), "{running:?}");
    }
}

#[test]
fn the_real_colmap_finds_the_poses_of_twelve_photographs() {
    if !tools::all_here(&["colmap"]) {
        return;
    }
    let Some(cup) = tools::data("real/cup_colmap/images") else { return };
    let folder = Folder::new();
    let photos = folder.path("cup");
    fs::create_dir(&photos).expect("a folder");
    for name in names(&cup).iter().take(12) {
        let photo = read_picture(cup.join(name));
        let small = photo.resize_exact(400, 300, image::imageops::FilterType::Triangle);
        write_picture(small, format!("{photos}/{name}.png"));
    }
    let made = ok(["poses", &photos, "--json", "-q"]);
    let said: serde_json::Value = serde_json::from_str(&made).expect("one object");
    println!("{said:#}");
    assert_eq!(said["photographs"], 12);
    assert!(said["registered"].as_u64() >= Some(10), "{said}");
    assert!(said["mean_reprojection_error_px"].as_f64().is_some_and(|e| e > 0.05 && e < 0.8), "{said}");
    ok(fit_grid(&folder.path("cup_poses"), &folder.path("cup.nerf"), &["--steps", "2"]));
}

/// A COLMAP capture with its photographs eight times smaller beside them.
fn with_images_8(folder: &Folder, capture: &Path) -> String {
    let copy = PathBuf::from(folder.path("capture"));
    fs::create_dir_all(copy.join("images_8")).expect("a folder");
    for name in ["images", "sparse"] {
        std::os::unix::fs::symlink(capture.join(name), copy.join(name)).expect("a link");
    }
    let photographs = names(&capture.join("images"));
    photographs.par_iter().for_each(|name| {
        let photograph = read_picture(capture.join("images").join(name));
        let (width, height) = (photograph.width() / 8, photograph.height() / 8);
        write_picture(photograph.thumbnail_exact(width, height), copy.join("images_8").join(name));
    });
    copy.display().to_string()
}

#[test]
fn one_camera_for_one_device_is_kept_beside_the_blob() {
    let Some(capture) = tools::data("real/cup_colmap") else { return };
    // Its photographs are made smaller once, not by each of the eight commands.
    let folder = Folder::new();
    let cup = with_images_8(&folder, &capture);
    let fitted = |name: &str, more: &[&str]| {
        let output = folder.path(name);
        let begin = ["fit", &cup, "-o", &output, "--steps", "2", "--downscale", "8", "--restart"];
        let fitted = ran(&mut command([&begin, crate::TINY_GRID, more].concat()));
        assert_eq!(fitted.code, Some(0), "{}", fitted.err);
        (fitted.err, fs::read(folder.path(name)).expect("a blob"))
    };
    let (said, first) = fitted("a.nerf", &[]);
    let words =
        ["one camera for 77 photographs: focal length 591", "before 593.3 (529.4 to 631.6)", "--cameras own"];
    assert!(words.iter().all(|word| said.contains(word)), "{said}");
    assert!(folder.names().contains(&"a.cameras.json".to_owned()), "{:?}", folder.names());
    let (said, second) = fitted("a.nerf", &[]);
    assert!(said.contains("read from") && first == second, "{said}");
    let (said, own) = fitted("own.nerf", &["--cameras", "own"]);
    assert!(!said.contains("one camera") && own != first, "{said}");
    assert!(!folder.names().contains(&"own.cameras.json".to_owned()), "{:?}", folder.names());

    // A blob is measured with the cameras that it was fitted with, also where it is alone.
    let psnr = |name: &str, more: &[&str]| {
        let blob = folder.path(name);
        let args = [&["eval", blob.as_str(), &cup, "--downscale", "8", "--json"], more].concat();
        let said: serde_json::Value = serde_json::from_str(&ok(args)).expect("one object");
        said["val_psnr_db"].as_f64().expect("a figure")
    };
    let beside = psnr("a.nerf", &[]);
    fs::remove_file(folder.path("a.cameras.json")).expect("it is there");
    assert_eq!(psnr("a.nerf", &[]), beside);
    assert!(!folder.names().contains(&"a.cameras.json".to_owned()), "eval writes nothing");
    assert_ne!(psnr("a.nerf", &["--cameras", "own"]), beside);
    assert_eq!(psnr("own.nerf", &[]), psnr("own.nerf", &["--cameras", "own"]));
    fails(
        fit(&cup, &folder.path("b.nerf"), &["--cameras", "mine"]),
        &["--cameras", "expected shared or own"],
    );
}
