//! Opening scenes, and what they say of themselves.

use crate::lent::{Lent, Message};
use arbitrary::{Result, Unstructured};
use nerf_fuzz::damage::{RECIPES, edit};
use nerf_fuzz::values::rarely;
use nerf_render::{self as ffi, Status};
use nerf_testing::call;
use nerf_testing::memory::Guarded;
use std::ffi::{CString, c_void};
use std::ptr::null;

pub struct Host {
    pub blob: Vec<u8>,
    pub memory: Guarded,
    pub scene: *const ffi::Scene,
}

/// Multiply-adds of a ray, about.
fn cost(blob: &nerf_core::Blob<'_>) -> usize {
    let samples = blob.scene().map_or(16, |scene| usize::from(scene.samples().max(16)));
    let coarse = blob.proposal().map_or(0, |it| usize::from(it.samples) * it.architecture().density_macs());
    blob.architecture().parameters() * samples + coarse
}

/// Opens a scene in memory of any size; `None` where that is refused.
pub fn open(u: &mut Unstructured<'_>) -> Result<Option<Host>> {
    let mut blob = u.choose(&RECIPES)?.blob();
    if u.ratio(1, 4)? {
        blob = edit(&blob, u).unwrap_or(blob);
    }
    // Beyond this one picture takes seconds.
    if nerf_core::Blob::open(&blob).is_ok_and(|blob| cost(&blob) > 200_000) {
        return Ok(None);
    }
    if rarely(u, 16)? {
        let bit = u.choose_index(8 * blob.len())?;
        blob[bit / 8] ^= 1 << (bit % 8);
    }
    let kernel = if u.ratio(1, 8)? { u.arbitrary()? } else { u.int_in_range(0..=5)? };
    let storage = if u.ratio(1, 8)? { u.arbitrary()? } else { u.int_in_range(0..=3)? };
    let options = ffi::OpenOptions {
        kernel,
        storage,
        reserved: [u32::from(rarely(u, 32)?); 6],
        ..call::open_options(nerf_core::Kernel::IN_PLACE)
    };
    let mut options = Lent::new(&options, u)?;
    let options: *const ffi::OpenOptions = if u.ratio(1, 8)? { null() } else { options.at() };
    let (mut size, mut align, mut message) = (usize::MAX, usize::MAX, Message::new(u)?);
    let bytes: *const c_void = if rarely(u, 32)? { null() } else { blob.as_ptr().cast() };
    let (text, room) = (message.at(), message.0.size());
    // SAFETY: everything lives until the call returns.
    let status =
        unsafe { ffi::nerf_scene_memory(bytes, blob.len(), options, &mut size, &mut align, text, room) };
    message.check(status);
    if status != Status::Ok {
        assert_eq!((size, align), (usize::MAX, usize::MAX), "{status:?}");
    } else {
        assert!(size % 64 == 0 && align == 64);
    }
    let (found, off) = (if status == Status::Ok { size } else { 4096 }, u.int_in_range(0..=15u8)?);
    let (given, misaligned) = match off {
        15 => (found - 1, 0),
        14 => (u.int_in_range(0..=found)?, 0),
        13 => (found, u.int_in_range(0..=63)?),
        12 => (found + u.int_in_range(0..=100usize)?, 0),
        _ => (found, 0),
    };
    let mut memory = Guarded::new(given, misaligned);
    let (at, mut scene) = (memory.at(), null());
    let mut message = Message::new(u)?;
    let (text, room) = (message.at(), message.0.size());
    // SAFETY: as above; blob and memory live as long as the host.
    let opened =
        unsafe { ffi::nerf_scene_open(bytes, blob.len(), options, at, given, &mut scene, text, room) };
    message.check(opened);
    assert!(memory.surroundings_are_intact(), "written beyond the scene's memory");
    let enough = status == Status::Ok && given >= size && misaligned == 0;
    assert_eq!(opened == Status::Ok, enough, "{opened:?} after {status:?}, {given} of {size}");
    if status == Status::Ok && given < size && misaligned == 0 {
        assert_eq!(opened, Status::Memory);
    }
    if opened != Status::Ok {
        assert!(scene.is_null() && memory.is_untouched(), "{opened:?}: a scene half open");
        return Ok(None);
    }
    assert_eq!(scene.cast(), at.cast_const());
    Ok(Some(Host { blob, memory, scene }))
}

pub fn describe(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
    // SAFETY: numbers and pointers, all of which may be 0.
    let info: ffi::SceneInfo = unsafe { std::mem::zeroed() };
    let mut info = Lent::new(&info, u)?;
    // SAFETY: the scene is intact and the place lives until the call returns.
    let status = unsafe { ffi::nerf_scene_describe(host.scene, info.at()) };
    if status != Status::Ok {
        assert!(
            matches!(status, Status::StructSize | Status::NullPointer) && info.is_untouched(),
            "{status:?}"
        );
    }
    let opened = nerf_core::Blob::open(&host.blob).expect("an open blob");
    let whole = info.words[0] as usize >= size_of::<ffi::SceneInfo>();
    if status == Status::Ok && whole {
        let info: ffi::SceneInfo = info.value();
        assert_eq!(info.parameters, opened.architecture().parameters() as u64);
    }
    // Any number has a text.
    // SAFETY: static and with an end, by contract.
    let text = unsafe { std::ffi::CStr::from_ptr(ffi::nerf_status_text(u.arbitrary()?)) };
    assert!(!text.is_empty());
    Ok(())
}

/// The host's bytes from a file, which opens where they do and is the same scene; a part of them is none.
pub fn file(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
    let path = std::env::temp_dir().join(format!("nerf-fuzz-{}.nerf", std::process::id()));
    let length = if u.ratio(1, 4)? { u.int_in_range(0..=host.blob.len() - 1)? } else { host.blob.len() };
    std::fs::write(&path, &host.blob[..length]).expect("a temporary file");
    let name = CString::new(path.to_str().expect("UTF-8")).expect("no NUL");
    let at = if rarely(u, 16)? { null() } else { name.as_ptr() };
    let (mut scene, mut message) = (null(), Message::new(u)?);
    let (text, room) = (message.at(), message.0.size());
    // SAFETY: everything lives until the call returns.
    let status = unsafe { ffi::nerf_scene_open_file(at, null(), &mut scene, text, room) };
    message.check(status);
    assert_eq!(status == Status::Ok, length == host.blob.len() && !at.is_null(), "{status:?}");
    assert_eq!(status == Status::Ok, !scene.is_null(), "{status:?}: a scene half open");
    if status == Status::Ok {
        let facts = |scene| {
            // SAFETY: numbers and pointers, all of which may be 0.
            let mut info: ffi::SceneInfo = unsafe { std::mem::zeroed() };
            info.struct_size = size_of::<ffi::SceneInfo>();
            // SAFETY: the scene is open and the place lives until the call returns.
            assert_eq!(unsafe { ffi::nerf_scene_describe(scene, &mut info) }, Status::Ok);
            (info.kind, info.parameters, info.density_macs, info.samples, info.front_points, info.seed)
        };
        assert_eq!(facts(scene), facts(host.scene));
    }
    // SAFETY: the first is open or NULL and used no more; the other is in the host's memory, where it stays.
    unsafe {
        ffi::nerf_scene_close(scene);
        ffi::nerf_scene_close(host.scene);
    }
    std::fs::remove_file(path).expect("a temporary file");
    Ok(())
}
