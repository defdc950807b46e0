use super::*;
use crate::tools::all_here;

fn ball(width: usize, height: usize, shift: usize) -> Picture {
    let pixel = |i: usize| {
        let (x, y) = ((i % width + shift) as f32 / width as f32, (i / width) as f32 / height as f32);
        [x.fract(), y, 0.25]
    };
    Picture::new(width, height, (0..width * height).map(pixel).collect()).unwrap()
}

/// Creates a script in place of ffmpeg, which lists libx264 as encoder, then runs `body`.
#[cfg(unix)]
fn fake(folder: &Path, body: &str) -> Ffmpeg {
    use std::os::unix::fs::PermissionsExt;
    let program = folder.join("fake-ffmpeg");
    let listing = "case \"$*\" in *-encoders*) echo ' V....D libx264 x'; exit 0;; esac";
    fs::write(&program, format!("#!/bin/sh\n{listing}\n{body}\n")).unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    Ffmpeg::find(Some(&program)).unwrap()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn odd_frames_repeat_their_last_column_and_row() {
    let picture = Picture::new(1, 3, vec![[0.0; 3], [0.2; 3], [1.0; 3]]).unwrap();
    let rows = [0u8, 51, 255, 255];
    assert_eq!(even_rgb8(&picture), rows.iter().flat_map(|&level| [level; 6]).collect::<Vec<u8>>());
    let even = ball(4, 2, 0);
    assert_eq!(even_rgb8(&even), even.to_rgb8());
}

#[test]
fn every_size_becomes_a_video_or_an_error() {
    if !all_here(&["ffmpeg"]) {
        return;
    }
    let ffmpeg = Ffmpeg::find(None).unwrap();
    for encoder in [X264, MPEG4] {
        let ffmpeg = Ffmpeg { encoder, ..ffmpeg.clone() };
        let folder = tempfile::tempdir().unwrap();
        for (width, height, frames) in [(16, 16, 5), (17, 9, 3), (1, 1, 1)] {
            let path = folder.path().join(format!("a: {width}.mp4"));
            let mut mp4 = Mp4Writer::create(&ffmpeg, &path, width, height, 12.5).unwrap();
            (0..frames).for_each(|i| mp4.push(&ball(width, height, i)).unwrap());
            mp4.finish().unwrap();
            let bytes = fs::read(&path).unwrap();
            assert_eq!(&bytes[4..8], b"ftyp", "{encoder:?} {width}×{height}");
            let place = |name: &[u8]| bytes.windows(4).position(|bytes| bytes == name).unwrap();
            assert!(place(b"moov") < place(b"mdat"), "not ready to stream");
        }
        assert_eq!(names(folder.path()).len(), 3);
    }
}

#[test]
fn wrong_calls_and_dropped_writers_leave_nothing() {
    if !all_here(&["ffmpeg"]) {
        return;
    }
    let ffmpeg = Ffmpeg::find(None).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mp4");
    let create = |width, fps| Mp4Writer::create(&ffmpeg, &path, width, 8, fps);
    assert!(create(0, 10.0).is_err() && create(8, 0.0).is_err() && create(8, f64::NAN).is_err());
    assert!(create(100_000, 10.0).is_err());
    let mut mp4 = create(8, 10.0).unwrap();
    mp4.push(&ball(8, 8, 0)).unwrap();
    assert!(mp4.push(&ball(9, 8, 0)).unwrap_err().to_string().contains("frame 1 is 9×8"));
    drop(mp4);
    assert!(create(8, 10.0).unwrap().finish().is_err());
    assert_eq!(names(folder.path()), [""; 0]);
}

#[test]
fn a_program_that_is_missing_or_no_ffmpeg_is_named() {
    let missing = Ffmpeg::find(Some(Path::new("no-such-ffmpeg"))).unwrap_err();
    assert!(missing.to_string().starts_with("no ffmpeg found (looked for `no-such-ffmpeg`"), "{missing}");
    for program in ["true", "false"] {
        let error = Ffmpeg::find(Some(Path::new(program))).unwrap_err().to_string();
        assert!(error.contains(program), "{error}");
    }
}

#[cfg(unix)]
#[test]
fn an_ffmpeg_that_fails_is_quoted_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mp4");
    let frame = ball(400, 400, 0);
    let cases = [
        // Four scripts fail: at once, after more messages than a pipe holds, after all frames, and by writing nothing.
        ("echo 'the sky is falling' >&2; exit 3", "the sky is falling"),
        (
            "i=0; while [ $i -lt 3000 ]; do echo 'a line that nobody reads, but all the same' >&2; i=$((i+1)); \
             done; echo last words >&2; exit 1",
            "last words",
        ),
        ("cat > /dev/null; echo 'no room' >&2; exit 1", "no room"),
        ("cat > /dev/null", "it said nothing"),
    ];
    for (body, words) in cases {
        let ffmpeg = fake(folder.path(), body);
        let mut mp4 = Mp4Writer::create(&ffmpeg, &path, 400, 400, 10.0).unwrap();
        let pushed = (0..4).try_for_each(|_| mp4.push(&frame));
        let error = pushed.and_then(|()| mp4.finish()).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("a.mp4"), "{body}: {error}");
        assert_eq!(names(folder.path()), ["fake-ffmpeg"], "{body}");
    }
}

#[test]
fn the_last_messages_are_shown() {
    assert_eq!(last_lines(b"a\n\nb\nc\nd\ne\n"), "b; c; d; e");
    assert_eq!(last_lines(b" \n"), "it said nothing");
}

#[cfg(unix)]
#[test]
fn an_ffmpeg_that_hangs_is_ended_after_a_stated_time() {
    let frame = ball(400, 400, 0);
    // Four scripts: ffmpeg reads nothing; a program that it started reads nothing; ffmpeg reads all and writes nothing;
    // it writes some. The last two get the time that a shell takes to start on a busy machine.
    let place = "for place; do :; done; place=${place#file:}";
    let cases = [
        ("exec sleep 1000", 300, "took nothing of a frame for 0.3 s"),
        ("sleep 1000", 300, "took nothing of a frame for 0.3 s"),
        ("cat > /dev/null; sleep 1000", 3000, "wrote nothing after its last frame, and did not end, for 3"),
        (&*format!("{place}; echo busy >&2; cat > \"$place\"; sleep 1000"), 3000, "busy"),
    ];
    let check = |(body, patience, words): (&str, u64, &str)| {
        let folder = tempfile::tempdir().unwrap();
        let ffmpeg = Ffmpeg { patience: Duration::from_millis(patience), ..fake(folder.path(), body) };
        let mut mp4 = Mp4Writer::create(&ffmpeg, folder.path().join("a.mp4"), 400, 400, 10.0).unwrap();
        let begun = Instant::now();
        let pushed = (0..4).try_for_each(|_| mp4.push(&frame));
        let error = pushed.and_then(|()| mp4.finish()).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("a.mp4"), "{body}: {error}");
        assert!(begun.elapsed() < Duration::from_secs(60), "{body}: {:?}", begun.elapsed());
        assert_eq!(names(folder.path()), ["fake-ffmpeg"], "{body}");
    };
    // Beside each other, since each of them waits.
    std::thread::scope(|scope| {
        for case in cases {
            let check = &check;
            scope.spawn(move || check(case));
        }
    });
}

#[cfg(unix)]
#[test]
fn an_ffmpeg_that_does_not_list_its_encoders_is_ended() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("hangs");
    fs::write(&program, "#!/bin/sh\nsleep 1000\n").unwrap();
    fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    let error = Ffmpeg::find_within(Some(&program), Duration::from_millis(200)).unwrap_err().to_string();
    assert!(error.contains("hangs` cannot be used") && error.contains("within 0.2 s"), "{error}");
}
