//! Points of a scene, and the rays of a camera.

use crate::draw::any_camera;
use crate::lent::{Lent, Message, workspace};
use crate::scenes::Host;
use crate::settings::options;
use arbitrary::{Result, Unstructured};
use nerf_fuzz::values::{any_f32, any_vec3};
use nerf_render::{self as ffi, Status};
use nerf_tests::call;
use nerf_tests::memory::Guarded;
use std::ptr::null_mut;

pub fn query(host: &Host, u: &mut Unstructured<'_>) -> Result<()> {
    let options = options(u)?;
    let mut options = Lent::new(&options, u)?;
    let n = u.int_in_range(0..=70usize)?;
    let (mut positions, mut dirs) = (Vec::new(), Vec::new());
    for _ in 0..n {
        positions.extend(any_vec3(u)?);
        let dir = glam_unit(any_vec3(u)?);
        dirs.extend(if u.ratio(1, 64)? { any_vec3(u)? } else { dir });
    }
    let colour: bool = u.arbitrary()?;
    let (mut sigma, mut rgb) = (Guarded::new(4 * n, 0), Guarded::new(12 * n, 0));
    let (mut size, mut align, none) = (usize::MAX, usize::MAX, null_mut());
    let asked = {
        let outputs = u32::from(colour) * ffi::NERF_OUTPUT_RGB;
        // SAFETY: the scene is intact and everything lives until the call returns.
        unsafe { ffi::nerf_workspace_size(host.scene, options.at(), outputs, &mut size, &mut align, none, 0) }
    };
    let known = asked == Status::Ok;
    if known && size > 1 << 25 {
        return Ok(());
    }
    let (mut room, enough) = workspace(u, known.then_some(size))?;
    let (mut counters, mut message) = (Lent::new(&call::counters(), u)?, Message::new(u)?);
    let (given, colours) = (room.size(), if colour { rgb.at().cast() } else { null_mut() });
    let (text, capacity) = (message.at(), message.0.size());
    // SAFETY: as above.
    let status = unsafe {
        ffi::nerf_query(
            host.scene,
            options.at(),
            n,
            positions.as_ptr(),
            dirs.as_ptr(),
            sigma.at().cast(),
            colours,
            room.at(),
            given,
            counters.at(),
            text,
            capacity,
        )
    };
    message.check(status);
    let intact = [&room, &sigma, &rgb].into_iter().all(Guarded::surroundings_are_intact);
    assert!(intact, "{status:?}: written beyond the memory that was lent");
    assert!(status != Status::Memory || !enough, "{status:?}: {given} bytes of {size} are too few");
    if status == Status::Ok {
        let sound = |bytes: &[u8]| bytes.as_chunks().0.iter().all(|&four| f32::from_le_bytes(four) >= 0.0);
        assert!(sound(sigma.bytes()), "a density below 0, or none");
        assert!(!colour || sound(rgb.bytes()), "a colour below 0, or none");
    } else {
        assert!(sigma.is_untouched() && rgb.is_untouched() && counters.is_untouched(), "{status:?}");
    }
    Ok(())
}

fn glam_unit(v: [f32; 3]) -> [f32; 3] {
    glam::Vec3::from(v).try_normalize().unwrap_or(glam::Vec3::Z).to_array()
}

pub fn cameras(u: &mut Unstructured<'_>) -> Result<()> {
    let mut camera = Lent::new(&any_camera(u)?, u)?;
    let (eye, target, up) = (any_vec3(u)?, any_vec3(u)?, any_vec3(u)?);
    let mut message = Message::new(u)?;
    let (text, capacity) = (message.at(), message.0.size());
    if u.arbitrary()? {
        // SAFETY: everything lives until the call returns.
        let status = unsafe {
            ffi::nerf_camera_look_at(camera.at(), eye.as_ptr(), target.as_ptr(), up.as_ptr(), text, capacity)
        };
        message.check(status);
        assert!(status == Status::Ok || camera.is_untouched(), "{status:?}: a camera half turned");
        return Ok(());
    }
    let (mut origin, mut dir, mut cosine) = ([7.0f32; 3], [7.0f32; 3], 7.0f32);
    let along = if u.arbitrary()? { null_mut() } else { &raw mut cosine };
    let (x, y) = (any_f32(u)?, any_f32(u)?);
    // SAFETY: as above.
    let status = unsafe {
        ffi::nerf_camera_ray(camera.at(), x, y, origin.as_mut_ptr(), dir.as_mut_ptr(), along, text, capacity)
    };
    message.check(status);
    if status == Status::Ok {
        let length = dir.iter().map(|x| x * x).sum::<f32>().sqrt();
        assert!((length - 1.0).abs() < 1e-6, "({x}, {y}): a direction of length {length}");
        assert!(origin.iter().all(|x| x.is_finite()) && cosine.is_finite());
    } else {
        assert_eq!((origin, dir, cosine), ([7.0; 3], [7.0; 3], 7.0), "{status:?}: a ray half written");
    }
    Ok(())
}
