//! Workers of one scene or of several instances, in memory of any size.

use crate::lent::{Lent, Message, workspace};
use crate::scenes::Host;
use arbitrary::{Result, Unstructured};
use nerf_fuzz::values::{any_f32, mostly, rarely};
use nerf_render::{self as ffi, Status};
use nerf_testing::call;
use nerf_testing::memory::Guarded;
use std::ffi::c_void;
use std::ptr::{null, null_mut};

pub struct Worker {
    pub handle: *mut ffi::Worker,
    pub memory: Guarded,
    /// Which hosts' scenes it works with.
    pub members: Vec<usize>,
    pub outputs: u32,
}

/// An array of instances, each as long as the first says.
struct Instances {
    bytes: Vec<u64>,
    members: Vec<usize>,
}

impl Instances {
    fn new(hosts: &[Host], u: &mut Unstructured<'_>) -> Result<Self> {
        let own = size_of::<ffi::Instance>();
        let step = match u.int_in_range(0..=31u8)? {
            31 => u.arbitrary()?,
            30 => own - 1,
            29 => own + u.int_in_range(0..=9usize)?,
            28 => own + 8 * u.int_in_range(0..=3usize)?,
            _ => own,
        };
        let members = (0..u.int_in_range(1..=3u8)?).map(|_| u.choose_index(hosts.len()));
        let members = members.collect::<Result<Vec<usize>>>()?;
        let mut bytes = vec![0u64; (members.len() * own.max(step.min(4096))).div_ceil(8)];
        for (i, &member) in members.iter().enumerate() {
            let scene = if rarely(u, 128)? { null() } else { hosts[member].scene };
            let instance = ffi::Instance { struct_size: step, scene, to_world: transform(u)? };
            // Of sizes that are refused there is only the first.
            if i == 0 || (own..=4096).contains(&step) {
                let at = bytes.as_mut_ptr().cast::<u8>().wrapping_add(i * step);
                // SAFETY: the array has room for as many of `step` bytes, and at least for one.
                unsafe { at.cast::<ffi::Instance>().write_unaligned(instance) };
            }
        }
        if rarely(u, 32)? && step > own + 8 && step <= 4096 {
            bytes[own / 8] = 1;
        }
        Ok(Self { bytes, members })
    }
}

/// A rotation times a scale and a translation, for the most part.
fn transform(u: &mut Unstructured<'_>) -> Result<[f32; 12]> {
    if u.ratio(1, 3)? {
        return Ok([0.0; 12]);
    }
    let any = u.arbitrary::<[i16; 4]>()?.map(f32::from);
    let turn = glam::Quat::from_vec4(glam::Vec4::from(any).try_normalize().unwrap_or(glam::Vec4::W));
    let scale = *u.choose(&[1.0f32, 0.5, 1e-3, 1e3, 1e9])?;
    let axes = glam::Mat3::from_quat(turn) * mostly(u, scale)?;
    let mut found = [0.0; 12];
    for row in 0..3 {
        found[4 * row..4 * row + 3].copy_from_slice(&axes.row(row).to_array());
        found[4 * row + 3] = mostly(u, 0.25 * row as f32)?;
    }
    if rarely(u, 16)? {
        found[u.choose_index(12)?] = any_f32(u)?;
    }
    Ok(found)
}

/// Opens a worker for the scene of a host, or for instances of any; `None` where that is refused.
pub fn open(
    hosts: &[Host],
    at: usize,
    options: *const ffi::RenderOptions,
    outputs: u32,
    u: &mut Unstructured<'_>,
) -> Result<Option<Worker>> {
    let mut request = call::request(hosts[at].scene, options, outputs);
    let mut members = vec![at];
    let instances = if rarely(u, 4)? { Some(Instances::new(hosts, u)?) } else { None };
    if let Some(instances) = &instances {
        let count = instances.members.len() - usize::from(rarely(u, 16)?);
        request.scene = if rarely(u, 64)? { request.scene } else { null() };
        (request.instances, request.instance_count) = (instances.bytes.as_ptr().cast(), count);
        members = instances.members[..count].to_vec();
    } else if rarely(u, 64)? {
        request.scene = null();
    }
    request.reserved = u32::from(rarely(u, 64)?);
    let mut request = Lent::new(&request, u)?;
    let (mut size, mut align, mut message) = (usize::MAX, usize::MAX, Message::new(u)?);
    let (text, capacity) = (message.at(), message.0.size());
    // SAFETY: scenes are intact and everything lives until the call returns.
    let asked = unsafe { ffi::nerf_worker_size(request.at(), &mut size, &mut align, text, capacity) };
    message.check(asked);
    let known = asked == Status::Ok;
    if known {
        assert!(size > 0 && size % 64 == 0 && align == 64);
    } else {
        assert_eq!((size, align), (usize::MAX, usize::MAX), "{asked:?}");
    }
    // Far more than any small scene needs.
    if known && size > 1 << 25 {
        return Ok(None);
    }
    let (mut memory, enough) = workspace(u, known.then_some(size))?;
    let (mut handle, given) = (null_mut(), memory.size());
    if known && rarely(u, 32)? {
        refused_over_a_scene(&hosts[*u.choose(&members)?], request.at(), size, u)?;
    }
    let mut message = Message::new(u)?;
    let (text, capacity) = (message.at(), message.0.size());
    // SAFETY: as above; the memory lives as long as the worker.
    let status =
        unsafe { ffi::nerf_worker_open(request.at(), memory.at(), given, &mut handle, text, capacity) };
    message.check(status);
    assert!(memory.surroundings_are_intact(), "{status:?}: written beyond the worker's memory");
    assert!(status != Status::Ok || enough, "{status:?} in {given} bytes, misaligned or of {size}");
    assert!(status != Status::Memory || !enough, "{status:?}: {given} bytes of {size} are too few");
    // Whether instances go together is looked at when they are opened.
    let placed = instances.is_some() && status == Status::Options;
    assert!(status == Status::Ok || !enough || placed, "{status:?} after {asked:?}");
    if status != Status::Ok {
        assert!(handle.is_null(), "{status:?}: a worker half open");
        return Ok(None);
    }
    assert_eq!(handle.cast::<c_void>(), memory.at());
    Ok(Some(Worker { handle, memory, members, outputs }))
}

/// A worker in the memory of its own scene, or of its blob.
fn refused_over_a_scene(
    host: &Host,
    request: *const ffi::Request,
    size: usize,
    u: &mut Unstructured<'_>,
) -> Result<()> {
    let place = *u.choose(&[host.scene.cast::<u8>(), host.blob.as_ptr()])?;
    let (place, mut handle) = (place.wrapping_add(place.align_offset(64)).cast_mut().cast(), null_mut());
    // SAFETY: scenes are intact and everything lives until the call returns.
    let status = unsafe { ffi::nerf_worker_open(request, place, size, &mut handle, null_mut(), 0) };
    assert!(status == Status::Overlap && handle.is_null(), "{status:?}: a worker over its scene");
    Ok(())
}

impl Worker {
    /// The handle, rarely none.
    pub fn handle(&self, u: &mut Unstructured<'_>) -> Result<*mut ffi::Worker> {
        Ok(if rarely(u, 64)? { null_mut() } else { self.handle })
    }

    /// Places that nothing may be written to: its memory, a scene of it, and that one's blob.
    pub fn places(&mut self, hosts: &[Host], u: &mut Unstructured<'_>) -> Result<[*mut c_void; 3]> {
        let host = &hosts[*u.choose(&self.members)?];
        Ok([self.memory.at(), host.scene.cast_mut().cast(), host.blob.as_ptr().cast_mut().cast()])
    }

    /// After a call: nothing was written around it, and it was not found at work.
    pub fn check(&self, status: Status) {
        assert!(self.memory.surroundings_are_intact(), "{status:?}: written beyond the worker's memory");
        assert!(!matches!(status, Status::Busy | Status::Memory), "{status:?}: of a worker that is open");
    }
}
