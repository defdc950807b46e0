//! Orbits and paths as GIF, MP4 and folders of frames.

use crate::made::{Array, Folder, names};
use crate::tools::all_here;
use crate::{Ran, blob, command, fails, ok, ran, read_picture, run};
use std::path::Path;

const ORBIT: &[&str] = &["--orbit", "3", "--width", "17", "--height", "9"];

/// Renders the blob of all tests to `output`.
fn render<'a>(file: &'a str, output: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["render", file, "-o", output], more].concat()
}

/// On a `PATH` that holds nothing.
fn without_ffmpeg(args: Vec<&str>) -> Ran {
    ran(command(args).env("PATH", ""))
}

/// How long each frame is shown, hundredths of a second.
fn delays_of(gif: &str) -> Vec<u16> {
    let file = std::fs::File::open(gif).expect(gif);
    let mut decoder = gif::DecodeOptions::new().read_info(file).expect("a GIF");
    std::iter::from_fn(|| decoder.read_next_frame().expect("a frame").map(|frame| frame.delay)).collect()
}

fn frames_of(gif: &str) -> usize {
    delays_of(gif).len()
}

#[test]
fn the_ending_decides_between_gif_and_mp4() {
    if !all_here(&["ffmpeg"]) {
        return;
    }
    let (_, file) = blob();
    let folder = Folder::new();
    let both = [ORBIT, &["--outputs", "rgb,z-depth"]].concat();
    let gifs = [folder.path("orbit.gif"), folder.path("orbit_z_depth.gif")];
    let mp4s = [folder.path("orbit.mp4"), folder.path("orbit_z_depth.mp4")];
    for files in [&gifs, &mp4s] {
        let said = ok(render(file, &files[0], &both));
        assert_eq!(said.lines().collect::<Vec<_>>(), files);
    }
    assert_eq!(gifs.map(|gif| frames_of(&gif)), [3, 3]);
    assert_eq!(folder.names().len(), 4, "{:?}", folder.names());
    for path in mp4s {
        assert_eq!(&std::fs::read(path).expect("an MP4")[4..8], b"ftyp");
    }
}

#[test]
fn without_ffmpeg_a_gif_is_made_and_an_mp4_is_refused_before_the_work() {
    let (_, file) = blob();
    let folder = Folder::new();
    let (gif, mp4) = (folder.path("orbit.gif"), folder.path("orbit.mp4"));
    let refused = without_ffmpeg(render(file, &mp4, ORBIT));
    assert_eq!(refused.code, Some(1));
    assert!(refused.err.starts_with("error: ") && refused.err.lines().count() == 1, "{}", refused.err);
    assert!(refused.err.contains("--ffmpeg") && refused.err.contains(&gif), "{}", refused.err);
    assert_eq!(folder.names(), [""; 0]);

    let made = without_ffmpeg(render(file, &gif, ORBIT));
    assert_eq!((made.code, frames_of(&gif)), (Some(0), 3), "{}", made.err);
    assert_eq!(made.out.trim(), gif);
    assert!(!made.err.contains("ffmpeg"), "{}", made.err);
    // One that was named must be there.
    let other = folder.path("other.mp4");
    fails(render(file, &other, &[ORBIT, &["--ffmpeg", "nowhere/ffmpeg"]].concat()), &["nowhere/ffmpeg"]);
    let by_name = ran(command(render(file, &other, ORBIT)).env("NERF_FFMPEG", "nowhere/ffmpeg"));
    assert!(by_name.code == Some(1) && by_name.err.contains("NERF_FFMPEG"), "{}", by_name.err);
    assert_eq!(folder.names(), ["orbit.gif"]);
}

#[cfg(unix)]
#[test]
fn an_ffmpeg_that_fails_is_quoted_and_leaves_no_mp4() {
    use std::os::unix::fs::PermissionsExt;
    let (_, file) = blob();
    let folder = Folder::new();
    let script = "#!/bin/sh\ncase \"$*\" in *-encoders*) echo ' V....D libx264 x'; exit 0;; esac\n\
                  echo 'the sky is falling' >&2\nexit 3\n";
    let fake = folder.file("fake", script);
    std::fs::set_permissions(&fake, std::fs::Permissions::from_mode(0o755)).expect("a script");
    let named = [ORBIT, &["--ffmpeg", &fake]].concat();
    fails(render(file, &folder.path("a.mp4"), &named), &["a.mp4", "the sky is falling"]);
    assert_eq!(folder.names(), ["fake"]);
}

#[test]
fn a_folder_gets_numbered_frames_also_transparent_ones() {
    let (_, file) = blob();
    let folder = Folder::new();
    let frames = folder.path("frames");
    let slash = format!("{frames}/");
    let more = ["--orbit", "3", "--width", "24", "-q", "--outputs", "rgb,z-depth"];
    let said = ok(render(file, &slash, &[&more[..], &["--transparent"]].concat()));
    assert_eq!(said.lines().collect::<Vec<_>>(), [&slash, &folder.path("frames_z_depth")]);
    let expected = ["frame_0000.png", "frame_0001.png", "frame_0002.png"];
    assert_eq!(names(Path::new(&frames)), expected);
    assert_eq!(names(Path::new(&folder.path("frames_z_depth"))), expected);
    let image::DynamicImage::ImageRgba8(clear) = read_picture(format!("{frames}/frame_0001.png")) else {
        panic!("no alpha")
    };
    assert!(clear.pixels().any(|p| p[3] == 0) && clear.pixels().any(|p| p[3] > 0));
    // Into the same folder, fewer and opaque; the old ones are pointed out.
    // From so far away that the corner sees nothing of the scene.
    let far = ["--orbit", "2", "--radius", "9", "--width", "24", "--background", "#ff0000"];
    let again = run(render(file, &frames, &far));
    assert!(again.code == Some(0) && again.err.contains("earlier run, from 2 on"), "{}", again.err);
    let red = read_picture(format!("{frames}/frame_0001.png")).into_rgb8();
    assert_eq!(red.get_pixel(0, 0).0, [255, 0, 0], "the remaining transmittance is red");
}

#[test]
fn frames_of_several_machines_are_those_of_one() {
    let (_, file) = blob();
    let folder = Folder::new();
    let orbit = ["--orbit", "5", "--width", "8", "--outputs", "rgb,z-depth"];
    let (whole, shared) = (folder.path("whole/"), folder.path("shared/"));
    ok(render(file, &whole, &orbit));
    ok(render(file, &shared, &[&orbit[..], &["--shard", "1/2"]].concat()));
    let mut pod = command(render(file, &shared, &orbit));
    let second = ran(pod.env("JOB_COMPLETION_INDEX", "1").env("JOB_COMPLETIONS", "2"));
    assert_eq!(second.code, Some(0), "{}", second.err);
    for name in ["whole", "whole_z_depth"] {
        let other = name.replace("whole", "shared");
        let [one, two] = [name, &other].map(|name| folder.path(name));
        let frames = names(Path::new(&one));
        assert_eq!((frames.len(), &frames), (5, &names(Path::new(&two))));
        for frame in frames {
            let read = |folder: &str| std::fs::read(format!("{folder}/{frame}")).expect("a frame");
            assert!(read(&one) == read(&two), "{name}/{frame}");
        }
    }
    fails(render(file, &folder.path("a.gif"), &["--orbit", "5", "--shard", "1/2"]), &["--shard", "a folder"]);
}

#[test]
fn a_path_goes_along_the_test_poses_or_another_split() {
    let (_, file) = blob();
    let folder = Folder::new();
    let plain = folder.npz("plain.npz");
    let data = folder.npz_with("data.npz", |arrays| {
        let poses = arrays.iter().find(|array| array.key == "c2ws_train").expect("poses");
        let data = poses.data[..4 * 16 * 8].to_vec();
        arrays.push(Array::new("c2ws_test", "<f8", "(4, 4, 4)", data));
    });
    let gif = folder.path("path.gif");
    let path = |data, more: &[&'static str]| {
        let args = render(file, &gif, &["--path", data, "--width", "8"]);
        [args, more.to_vec()].concat()
    };
    let said = ok(path(&data, &["--outputs", "z-depth", "--json"]));
    let said: serde_json::Value = serde_json::from_str(&said).expect("one object");
    assert_eq!((said["frames"].as_u64(), said["width_px"].as_u64()), (Some(4), Some(8)));
    let range = |i: usize| said["z_depth_range"][i].as_f64().expect("a range");
    assert!(range(0) < range(1), "{said}");
    assert_eq!(frames_of(&gif), 4);
    ok(path(&data, &["--split", "val"]));
    assert_eq!(frames_of(&gif), 2);
    ok(render(file, &folder.path("pose.png"), &["--data", &data, "--split", "test", "--view", "3"]));
    fails(path(&plain, &[]), &["--path", "`test`", "plain.npz", "--split"]);
}

#[test]
fn a_path_is_nerfstudios_or_a_list_and_keyframes_are_flown_through() {
    let (made, file) = blob();
    let (folder, data) = (Folder::new(), made.path("scene.npz"));
    let gif = folder.path("path.gif");
    let said = |args: &[&str]| -> serde_json::Value {
        let args = [&["render", file, "-q", "-o", &gif, "--json"], args].concat();
        serde_json::from_str(&ok(args)).expect("one object")
    };
    let matrix = "[1,0,0,0, 0,1,0,0, 0,0,1,4, 0,0,0,1]";
    let studio = folder.file(
        "camera_path.json",
        format!(
            "{{\"camera_type\": \"perspective\", \"render_width\": 16, \"render_height\": 9, \"fps\": 24,
            \"camera_path\": [{{\"camera_to_world\": {matrix}, \"fov\": 50}},
                {{\"camera_to_world\": {matrix}, \"fov\": 60}}, {{\"camera_to_world\": {matrix}}}]}}"
        ),
    );
    let of_studio = said(&["--path", &studio]);
    assert_eq!(
        (&of_studio["frames"], &of_studio["width_px"], &of_studio["height_px"]),
        (&3.into(), &16.into(), &9.into())
    );
    assert_eq!(frames_of(&gif), 3);
    assert_eq!(delays_of(&gif), [4, 4, 5], "the file's 24 frames a second");
    said(&["--path", &studio, "--fps", "10"]);
    assert_eq!(delays_of(&gif), [10; 3]);
    let wide = said(&["--path", &studio, "--width", "32"]);
    assert_eq!(
        (&wide["width_px"], &wide["height_px"]),
        (&32.into(), &18.into()),
        "the shape stays the file's"
    );
    let list = folder.file("list.json", format!("[{matrix}, {matrix}]"));
    assert_eq!(said(&["--path", &list, "--width", "8"])["frames"], 2);
    assert_eq!(said(&["--path", &list, "--width", "8", "--frames", "5"])["frames"], 5);
    // The field of view is vertical: the first frame is this view.
    let (frames, view) = (folder.path("frames/"), folder.path("view.png"));
    ok(["render", file, "-q", "-o", &frames, "--path", &studio]);
    let focal = format!("{}", 4.5 / 25f64.to_radians().tan());
    let pose = "1,0,0,0,0,1,0,0,0,0,1,4";
    ok([
        "render", file, "-q", "-o", &view, "--pose", pose, "--focal", &focal, "--width", "16", "--height",
        "9",
    ]);
    assert_eq!(read_picture(format!("{frames}frame_0000.png")), read_picture(&view));

    let flown = said(&["--data", &data, "--split", "train", "--keyframes", "0,3,1", "--frames", "7"]);
    assert_eq!(flown["frames"], 7);
    let refused = |args: &[&str], words: &[&str]| {
        fails([&["render", file, "-q", "-o", &folder.path("no.gif")], args].concat(), words);
    };
    refused(
        &["--path", &folder.file("empty.json", "{\"camera_path\": []}")],
        &["empty.json", "at least one camera"],
    );
    refused(&["--path", &folder.file("none.json", "[]")], &["none.json", "at least one camera"]);
    refused(&["--path", &folder.file("bad.json", "[[1,2]]")], &["bad.json", "[0]", "4 numbers"]);
    refused(&["--data", &data, "--keyframes", "0,9"], &["--keyframes", "expected less than 2", "9"]);
    refused(&["--data", &data, "--keyframes", "0,1", "--frames", "0"], &["--frames", "at least 1"]);
    refused(&["--orbit", "3", "--frames", "5"], &["--frames", "--keyframes"]);
    refused(&["--path", &data, "--split", "train", "--frames", "5"], &["--frames", "a camera path"]);
    refused(&["--path", &studio, "--split", "train"], &["--split", "camera_path.json"]);
    assert!(!folder.names().contains(&"no.gif".to_owned()));
}

#[test]
fn names_that_cannot_hold_what_is_asked_are_refused() {
    let (_, file) = blob();
    let folder = Folder::new();
    let cases: [(&str, &[&str], &str); 9] = [
        ("a.png", &["--orbit", "2"], "-o: expected .gif, .mp4"),
        ("a.gif", &[], "--orbit"),
        ("a.mp4", &["--width", "4"], "--orbit"),
        ("a.gif", &["--orbit", "2", "--transparent"], "--transparent"),
        ("a.gif", &["--orbit", "2", "--path", "b.npz"], "--path"),
        ("a.gif", &["--orbit", "2", "--split", "val"], "--split"),
        ("a.gif", &["--orbit", "0"], "--orbit"),
        ("a.gif", &["--orbit", "2", "--fps", "0"], "frames per second"),
        ("a.gif", &["--path", "nowhere.npz"], "nowhere.npz"),
    ];
    for (name, more, word) in cases {
        fails(render(file, &folder.path(name), &[more, &["-q"]].concat()), &[word]);
        assert_eq!(folder.names(), [""; 0], "{name} {more:?}");
    }
}
