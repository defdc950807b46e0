//! An input is never an output: every command, and every way in which an output can be an input.

use crate::made::Folder;
use crate::{blob, command, fit, ok, ran, write_picture};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What an error must name of a path: through a folder that is not there, it says where that leads.
fn last(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// Everything in a folder: names, what is in the files, where links lead.
fn tree(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            let kind = std::fs::symlink_metadata(&path).expect("there").file_type();
            let content = if kind.is_symlink() {
                std::fs::read_link(&path).expect("a link").into_os_string().into_encoded_bytes()
            } else if kind.is_dir() {
                open.push(path.clone());
                Vec::new()
            } else {
                std::fs::read(&path).expect("a file")
            };
            found.insert(path, content);
        }
    }
    found
}

/// Runs a command in `folder` that must be refused in one line that names `word`; nothing there may change.
fn refused(folder: &Path, args: &[&str], word: &str) {
    let before = tree(folder);
    let ran = ran(command(args).current_dir(folder));
    assert!(matches!(ran.code, Some(1 | 2)), "{args:?}: status {:?}: {} {}", ran.code, ran.out, ran.err);
    let lines: Vec<&str> = ran.err.lines().filter(|line| line.contains("error:")).collect();
    assert!(
        lines.len() == 1 && ran.err.lines().count() == 1 && lines[0].contains(word),
        "{args:?}: {}",
        ran.err
    );
    let is_why = ["would be destroyed", "which is being read"].iter().any(|why| lines[0].contains(why));
    assert!(is_why, "{args:?}: {}", ran.err);
    let after = tree(folder);
    assert!(before.keys().eq(after.keys()), "{args:?} left {:?}", after.keys().collect::<Vec<_>>());
    assert!(before == after, "{args:?} changed a file");
}

/// Every name by which a file can be written; each with its folder's other contents in place.
fn names_of(folder: &Path, file: &str) -> Vec<String> {
    let path = folder.join(file);
    let absolute = path.to_str().expect("UTF-8").to_owned();
    let (stem, extension) = file.rsplit_once('.').expect("an extension");
    let mut names = vec![
        file.to_owned(),
        format!("./sub/../{file}"),
        format!("./sub/../{file}"),
        format!("./absent/../{file}"),
        format!("sub/./..//{file}"),
        absolute,
    ];
    std::fs::create_dir_all(folder.join("sub")).expect("a folder");
    let hard = format!("{stem}_hard.{extension}");
    std::fs::hard_link(&path, folder.join(&hard)).expect("a hard link");
    names.push(hard);
    #[cfg(unix)]
    {
        use std::os::unix::fs::symlink;
        let soft = format!("{stem}_soft.{extension}");
        symlink(file, folder.join(&soft)).expect("a link");
        symlink(&soft, folder.join(format!("{stem}_twice.{extension}"))).expect("a link");
        if !folder.join("alias").exists() {
            symlink(".", folder.join("alias")).expect("a link");
        }
        names.extend([soft, format!("{stem}_twice.{extension}"), format!("alias/{file}")]);
    }
    let other_case = format!("{}.{extension}", stem.to_uppercase());
    if folder.join(&other_case).exists() {
        names.push(other_case);
    } else {
        println!("skipped: this file system tells case apart");
    }
    names
}

/// With what inputs are really made of, so that a command that did not refuse would go on and write.
#[test]
fn the_commands_that_destroyed_their_input_refuse_and_leave_it() {
    let folder = Folder::new();
    let root = folder.path("");
    let root = Path::new(&root);
    folder.npz("d.nerf");
    std::fs::copy(&blob().1, root.join("c.png")).expect("copied");
    write_picture(image::RgbImage::from_pixel(12, 8, image::Rgb([9, 90, 200])), root.join("p.png"));
    ok([
        "image",
        "fit",
        &folder.path("p.png"),
        "-o",
        &folder.path("f.nerf"),
        "-q",
        "--steps",
        "2",
        "--width",
        "8",
    ]);
    std::fs::rename(root.join("f.nerf"), root.join("f.png")).expect("renamed");
    std::fs::rename(root.join("p.png"), root.join("p.nerf")).expect("renamed");
    folder.blender("scene");
    let cases: [(&str, &[&str]); 5] = [
        ("c.png", &["render", "c.png", "--width", "4", "-o"]),
        ("f.png", &["image", "render", "f.png", "-o"]),
        ("p.nerf", &["image", "fit", "p.nerf", "--steps", "2", "-o"]),
        ("d.nerf", &["fit", "d.nerf", "--steps", "2", "-o"]),
        ("d.nerf", &["import", "d.nerf", "-o"]),
    ];
    for (file, args) in cases {
        let stem = Path::new(file).file_stem().and_then(|stem| stem.to_str()).expect("a stem");
        let names = if root.join(format!("{stem}_hard.nerf")).exists() {
            vec![file.to_owned()]
        } else {
            names_of(root, file)
        };
        for name in names {
            refused(root, &[args, &[&name]].concat(), last(&name));
        }
    }
    refused(root, &["fit", "scene", "-o", "a.nerf", "--steps", "2", "--report", "scene"], "scene");
}

#[test]
fn no_output_may_be_an_input_by_any_name() {
    // Refused before anything is read: what is in the files does not matter, but for a TOML file.
    let blobs: &[&[&str]] = &[
        &["fit", "IN", "-o", "OUT"],
        &["fit", "data", "--config", "IN", "-o", "OUT"],
        &["study", "IN", "data", "-o", "OUT"],
        &["study", "blob", "IN", "-o", "OUT"],
        &["study", "blob", "data", "--source", "IN", "-o", "OUT"],
        &["study", "blob", "IN", "--write", "--source", "OUT"],
        &["image", "fit", "IN", "-o", "OUT"],
        &["import", "IN", "-o", "OUT"],
        &["import", "a", "--coarse", "IN", "-o", "OUT"],
        &["import", "a", "--occupancy", "IN", "-o", "OUT"],
        &["import", "a", "--check", "IN", "-o", "OUT"],
    ];
    let pictures: &[&[&str]] = &[
        &["render", "IN", "-o", "OUT"],
        &["render", "blob", "--data", "IN", "-o", "OUT"],
        &["image", "render", "IN", "-o", "OUT"],
    ];
    let videos: &[&[&str]] =
        &[&["render", "IN", "--orbit", "2", "-o", "OUT"], &["render", "blob", "--path", "IN", "-o", "OUT"]];
    for (file, commands) in [("in.nerf", blobs), ("in.png", pictures), ("in.gif", videos)] {
        let folder = Folder::new();
        folder.file(file, "");
        let root = folder.path("");
        let names = names_of(Path::new(&root), file);
        for args in commands {
            if args.contains(&"--write") {
                continue;
            }
            for name in &names {
                let args: Vec<&str> = args
                    .iter()
                    .map(|&arg| {
                        if arg == "IN" {
                            file
                        } else if arg == "OUT" {
                            name
                        } else {
                            arg
                        }
                    })
                    .collect();
                refused(Path::new(&root), &args, last(name));
            }
        }
    }
    // A blob that is replaced in place is no other input.
    let folder = Folder::new();
    folder.file("both.nerf", "");
    let root = folder.path("");
    refused(Path::new(&root), &["study", "both.nerf", "both.nerf", "--write"], "both.nerf");
}

/// Files that a command writes without having been told their names.
#[test]
fn derived_outputs_are_no_inputs_either() {
    let cases: &[(&str, &[&str])] = &[
        ("a.nerf.checkpoint", &["fit", "IN", "-o", "a.nerf"]),
        ("a.nerf.checkpoint", &["fit", "IN", "-o", "a.nerf", "--resume"]),
        ("v_z_depth.png", &["render", "IN", "-o", "v.png", "--outputs", "rgb,z-depth"]),
        ("v_normals.png", &["render", "IN", "-o", "v.png", "--outputs", "all"]),
        ("v_opacity.gif", &["render", "IN", "-o", "v.gif", "--orbit", "2", "--outputs", "rgb,opacity"]),
        ("frames/frame_0001.png", &["render", "IN", "-o", "frames/", "--orbit", "2"]),
        (
            "frames_z_depth/frame_0000.png",
            &["render", "IN", "-o", "frames", "--orbit", "2", "--outputs", "rgb,z-depth"],
        ),
        ("r/curve.csv", &["fit", "IN", "-o", "a.nerf", "--report", "r"]),
        ("r/data.json", &["fit", "IN", "-o", "a.nerf", "--report", "./r"]),
        ("r/any view.png", &["fit", "IN", "-o", "a.nerf", "--report", "r"]),
        ("r/snapshots/step_000000_v.png", &["fit", "IN", "-o", "a.nerf", "--report", "r"]),
        ("r/summary.json", &["fit", "data", "-o", "a.nerf", "--config", "IN", "--report", "r"]),
        ("r/views.csv", &["eval", "IN", "data", "--report", "r"]),
        ("r/summary.json", &["eval", "blob", "IN", "--report", "r"]),
        ("r/r_0.png", &["eval", "blob", "IN", "--report", "r"]),
        ("r/audit.csv", &["audit", "IN", "data", "--report", "r"]),
        ("r/summary.json", &["audit", "blob", "IN", "--report", "r"]),
        ("r/points.csv", &["study", "IN", "data", "--report", "r"]),
        ("r/front.svg", &["study", "blob", "data", "--source", "IN", "--report", "r"]),
        ("r/difference_a_truth.png", &["study", "blob", "IN", "--report", "r"]),
        ("r/picture.png", &["image", "fit", "IN", "-o", "a.nerf", "--report", "r"]),
        (
            "r/snapshots/step_000020.png",
            &["image", "fit", "IN", "-o", "a.nerf", "--report", "r", "--snapshots", "20"],
        ),
        ("r/show.html", &["show", "IN", "-o", "r"]),
        ("r/demo.nerf", &["demo", "--config", "IN", "--out", "r"]),
        ("r/orbit.gif", &["demo", "--config", "IN", "--out", "r"]),
        ("r/sheet.png", &["sweep", "image", "IN", "-o", "r", "--levels", "1,2"]),
        ("r/runs/a.png", &["sweep", "image", "IN", "-o", "r", "--levels", "1,2"]),
        ("r/table.csv", &["sweep", "scene", "IN", "-o", "r", "--width", "8,16"]),
        ("r/sweep.json", &["sweep", "scene", "data", "--config", "IN", "-o", "r", "--width", "8,16"]),
    ];
    for (file, args) in cases {
        // The input under that name; as a link to one elsewhere; as another name of one elsewhere.
        for way in ["itself", "link", "hard link"] {
            let folder = Folder::new();
            let path = folder.path(file);
            std::fs::create_dir_all(Path::new(&path).parent().expect("a folder")).expect("a folder");
            let (input, elsewhere) = (folder.path("input.toml"), Path::new("input.toml"));
            std::fs::write(if way == "itself" { &path } else { &input }, "").expect("written");
            match way {
                #[cfg(unix)]
                "link" => std::os::unix::fs::symlink(&input, &path).expect("a link"),
                "hard link" => std::fs::hard_link(&input, &path).expect("a hard link"),
                _ => {}
            }
            let of = if Path::new(&input).exists() { elsewhere } else { Path::new(file) };
            let of = of.to_str().expect("UTF-8");
            let args: Vec<&str> = args.iter().map(|&arg| if arg == "IN" { of } else { arg }).collect();
            refused(
                Path::new(&folder.path("")),
                &args,
                Path::new(file).file_name().and_then(|n| n.to_str()).expect("a name"),
            );
        }
    }
}

#[test]
fn nothing_is_written_into_a_data_set_that_is_a_folder() {
    let folder = Folder::new();
    folder.blender("scene");
    let root = folder.path("");
    let root = Path::new(&root);
    #[cfg(unix)]
    std::os::unix::fs::symlink("scene", root.join("alias")).expect("a link");
    let mut places =
        vec!["scene", "scene/", "./scene/../scene", "scene/out", "scene/train", "scene/new/deep"];
    if cfg!(unix) {
        places.extend(["alias", "alias/out"]);
    }
    let folders: &[&[&str]] = &[
        &["fit", "scene", "-o", "a.nerf", "--report"],
        &["fit", "scene/transforms_train.json", "-o", "a.nerf", "--report"],
        &["eval", "blob", "scene", "--report"],
        &["audit", "blob", "scene", "--report"],
        &["study", "blob", "scene", "--report"],
        &["show", "scene", "-o"],
        &["sweep", "scene", "scene", "--width", "8,16", "-o"],
        &["render", "blob", "--path", "scene", "-o"],
    ];
    for args in folders {
        for place in &places {
            // Of a data set that is named by its list, the files are protected, not the folder.
            if args.contains(&"scene/transforms_train.json") && *place != "scene/train" {
                continue;
            }
            refused(root, &[*args, &[*place]].concat(), place.trim_end_matches('/'));
        }
    }
    let files: &[(&[&str], &str)] = &[
        (&["fit", "scene"], "nerf"),
        (&["import", "a", "--check", "scene"], "nerf"),
        (&["study", "blob", "scene"], "nerf"),
        (&["render", "blob", "--data", "scene"], "png"),
        (&["render", "blob", "--path", "scene"], "gif"),
    ];
    for (args, extension) in files {
        for place in &places {
            let output = format!("{}/a.{extension}", place.trim_end_matches('/'));
            refused(root, &[*args, &["-o", output.as_str()]].concat(), &output);
        }
    }
    // Pictures of it, also by another name, where its list is what was named, or they lie elsewhere.
    std::fs::rename(root.join("scene/val/r_1.png"), root.join("far.png")).expect("moved");
    #[cfg(unix)]
    std::os::unix::fs::symlink("../../far.png", root.join("scene/val/r_1.png")).expect("a link");
    std::fs::hard_link(root.join("scene/train/r_2.png"), root.join("hard.png")).expect("a hard link");
    let mut pictures = vec!["scene/train/r_0.png", "scene/val/../train/r_1.png", "hard.png"];
    if cfg!(unix) {
        pictures.push("far.png");
    }
    for data in ["scene", "scene/transforms_val.json"] {
        for picture in &pictures {
            refused(root, &["render", "blob", "--data", data, "-o", picture], picture);
        }
    }
    // Folders of a sweep are read as a whole, too.
    std::fs::create_dir(root.join("part")).expect("a folder");
    refused(root, &["sweep", "merge", "-o", "part", "part"], "part");
    refused(root, &["sweep", "merge", "-o", "part/all", "part"], "part/all");
}

#[test]
fn places_beside_the_data_and_devices_stay_allowed() {
    let folder = Folder::new();
    folder.blender("scene");
    folder.npz("data.npz");
    let root = folder.path("");
    let run = |args: &[&str]| {
        let ran = ran(command(args).current_dir(&root));
        assert_eq!(ran.code, Some(0), "{args:?}: {}", ran.err);
    };
    run(&fit("scene", "scene.nerf", &["--steps", "2", "--report", "scene_report"]));
    run(&fit("data.npz", "a.nerf", &["--steps", "2", "--report", "."]));
    run(&fit("scene/transforms_train.json", "scene/b.nerf", &["--steps", "2"]));
    run(&["eval", "a.nerf", "data.npz", "-q", "--report", "./"]);
    run(&["render", "a.nerf", "-q", "--width", "4", "-o", "new/deep/v.png"]);
    if cfg!(unix) {
        run(&fit("data.npz", "/dev/null", &["--steps", "2"]));
        assert!(!Path::new("/dev/null.checkpoint").exists());
        run(&["render", "a.nerf", "-q", "--width", "4", "-o", "/dev/null"]);
        run(&["render", "a.nerf", "-q", "--width", "4", "-o", "/dev/stdout"]);
    }
}
