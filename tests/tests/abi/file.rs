//! `nerf_scene_open_file` and `nerf_scene_close`, the only functions with which the library owns memory.

use nerf_core::Kernel;
use nerf_render as ffi;
use nerf_render::Status;
use nerf_testing::call::{self, Message, plane};
use nerf_testing::paths;
use nerf_testing::scenes::{Recipe, camera, kernels};
use std::ffi::{CString, OsStr};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::ptr::{null, null_mut};

/// Opens a scene file. Verifies that the handle is written on success only.
fn open(path: &Path, kernel: Kernel) -> (Status, *const ffi::Scene, String) {
    let path = CString::new(path.as_os_str().as_bytes()).expect("a path without NULs");
    let (options, mut message, mut scene) = (call::open_options(kernel), Message::default(), null());
    // SAFETY: everything lives until the call returns.
    let status = unsafe {
        ffi::nerf_scene_open_file(path.as_ptr(), &options, &mut scene, message.0.as_mut_ptr(), 256)
    };
    assert_eq!(scene.is_null(), status != Status::Ok);
    (status, scene, message.text())
}

/// Renders the image of a scene, in a workspace of its own.
fn picture(scene: *const ffi::Scene) -> Vec<[f32; 3]> {
    let (camera, mut pixels) = (call::camera(&camera(24, 24)), vec![[0.0f32; 3]; 24 * 24]);
    let target = call::target(plane(pixels.as_mut_ptr().cast(), ffi::PixelFormat::RgbF32));
    let (mut size, mut align, none) = (0, 0, null_mut());
    // SAFETY: the scene is open and the places live until the call returns.
    let status =
        unsafe { call::worker_size(scene, null(), ffi::NERF_OUTPUT_RGB, &mut size, &mut align, none, 0) };
    assert_eq!(status, Status::Ok);
    let mut workspace = nerf_testing::memory::Guarded::new(size, 0);
    // SAFETY: as above.
    let status = unsafe { call::frame(scene, &camera, &target, workspace.at(), size) };
    assert_eq!(status, Status::Ok);
    pixels
}

#[test]
fn a_scene_from_a_file_is_the_scene_of_its_bytes() {
    let directory = paths::temporary();
    // Names are bytes: this one is no UTF-8.
    let file = directory.path().join(OsStr::from_bytes(b"sc\xffne.nerf"));
    for (kernel, recipe) in
        kernels().flat_map(|kernel| [(kernel, Recipe::PLAIN), (kernel, Recipe::OCCUPANCY)])
    {
        std::fs::write(&file, recipe.blob()).expect("a temporary file");
        let lent = call::open(recipe.blob(), kernel);
        let (status, scene, message) = open(&file, kernel);
        assert_eq!((status, message.as_str()), (Status::Ok, ""));
        // The file is read, not mapped: it may change and go.
        std::fs::write(&file, b"gone").expect("a temporary file");
        assert!(picture(scene) == picture(lent.scene), "{}", kernel);
        // SAFETY: nobody uses the first any more; the second lies in memory of the caller.
        unsafe {
            ffi::nerf_scene_close(scene);
            ffi::nerf_scene_close(lent.scene);
            ffi::nerf_scene_close(null());
        }
        picture(lent.scene);
    }
}

#[test]
fn files_that_are_no_scene_are_named_with_the_reason() {
    let directory = paths::temporary();
    let blob = Recipe::PLAIN.blob();
    let refused = |name: &str, bytes: Option<&[u8]>, expected: Status, said: &str| {
        let file = directory.path().join(name);
        if let Some(bytes) = bytes {
            std::fs::write(&file, bytes).expect("a temporary file");
        }
        let (status, _, message) = open(&file, Kernel::IN_PLACE);
        assert_eq!(status, expected, "{name}: {message}");
        let path = file.display().to_string();
        assert!(message.starts_with(&path[..path.len().min(200)]), "{message}");
        assert!(message.contains(said), "{name}: {message}");
    };
    let mut damaged = blob.clone();
    *damaged.last_mut().expect("bytes") ^= 1;
    let longer = [&blob[..], b"x"].concat();
    let (all, cut) = (blob.len(), blob.len() - 1);
    refused("absent.nerf", None, Status::File, "No such file");
    refused(".", None, Status::File, "found a folder");
    let pipe = std::process::Command::new("mkfifo").arg(directory.path().join("pipe")).status();
    assert!(pipe.is_ok_and(|status| status.success()));
    refused("pipe", None, Status::File, "a pipe");
    refused("empty.nerf", Some(b""), Status::BlobMagic, "");
    refused("text.nerf", Some(b"a letter to my mother, who knows"), Status::BlobMagic, "");
    refused("head.nerf", Some(&blob[..20]), Status::BlobTruncated, "32");
    refused("cut.nerf", Some(&blob[..cut]), Status::BlobTruncated, &all.to_string());
    refused("longer.nerf", Some(&longer), Status::BlobTrailing, &longer.len().to_string());
    refused("damaged.nerf", Some(&damaged), Status::BlobChecksum, "CRC-32");
    // A terabyte of nothing is refused by its first bytes, and a blob that claims one by the file's length.
    let sparse = std::fs::File::create(directory.path().join("sparse.nerf")).expect("a temporary file");
    sparse.set_len(1 << 40).expect("a sparse file");
    refused("sparse.nerf", None, Status::BlobMagic, "");
    let mut boastful = blob;
    boastful[16..24].copy_from_slice(&(1u64 << 40).to_le_bytes());
    refused("boastful.nerf", Some(&boastful), Status::BlobTruncated, &((1u64 << 40) + 32).to_string());
}

#[test]
fn arguments_are_checked() {
    let (mut scene, mut message) = (null(), Message::default());
    // SAFETY: everything lives until the call returns.
    let status =
        unsafe { ffi::nerf_scene_open_file(null(), null(), &mut scene, message.0.as_mut_ptr(), 256) };
    assert_eq!(
        (status, message.text().as_str()),
        (Status::NullPointer, "path: expected an address, found NULL")
    );
    // SAFETY: as above.
    let status =
        unsafe { ffi::nerf_scene_open_file(c"x".as_ptr(), null(), null_mut(), message.0.as_mut_ptr(), 256) };
    assert_eq!(
        (status, message.text().as_str()),
        (Status::NullPointer, "scene: expected an address, found NULL")
    );
    let options = ffi::OpenOptions { kernel: 99, ..call::open_options(Kernel::IN_PLACE) };
    // SAFETY: as above.
    let status = unsafe {
        ffi::nerf_scene_open_file(c"x".as_ptr(), &options, &mut scene, message.0.as_mut_ptr(), 256)
    };
    assert_eq!(status, Status::Options);
}
