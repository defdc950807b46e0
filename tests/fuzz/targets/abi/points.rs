//! Points and rays of the host's own, and the rays of a camera.

use crate::draw::{Drawing, any_camera};
use crate::lent::{Lent, Message};
use crate::numbers::{Numbers, direction};
use crate::planes::surface;
use crate::scenes::Host;
use crate::settings::options;
use crate::workers;
use arbitrary::{Result, Unstructured};
use nerf_fuzz::values::{any_f32, any_vec3, rarely};
use nerf_render::{self as ffi, Status};
use nerf_testing::call;
use std::ffi::c_void;
use std::ptr::{null, null_mut};

/// No numbers, or the lent ones.
fn lent(numbers: Option<&Numbers>) -> ffi::Floats {
    numbers.map_or(call::floats(null()), Numbers::lent)
}

/// How many there are said to be: rarely more than any memory has.
fn said(count: usize, u: &mut Unstructured<'_>) -> Result<usize> {
    Ok(if rarely(u, 128)? { *u.choose(&[usize::MAX, usize::MAX / 4, usize::MAX / 12])? } else { count })
}

pub fn query(hosts: &[Host], at: usize, u: &mut Unstructured<'_>) -> Result<()> {
    let mut options = Lent::new(&options(u)?, u)?;
    let (n, garbage) = (u.int_in_range(0..=70usize)?, u.ratio(1, 4)?);
    let (mut positions, mut dirs) = (Vec::new(), Vec::new());
    for _ in 0..n {
        positions.extend(any_vec3(u)?);
        dirs.extend(direction(garbage, u)?);
    }
    let (positions, dirs) = (Numbers::new(&positions, 3, u)?, Numbers::new(&dirs, 3, u)?);
    let colour: bool = u.arbitrary()?;
    let (Some(sigma), Some(mut rgb)) =
        (surface(u, n as u32, 1, false, false)?, surface(u, n as u32, 1, false, true)?)
    else {
        return Ok(());
    };
    if rgb.plane.format == ffi::PixelFormat::Vec3F32 as u32 {
        rgb.plane.format = ffi::PixelFormat::RgbF32 as u32;
    }
    let outputs = if rarely(u, 16)? { u.arbitrary()? } else { u32::from(colour) * ffi::NERF_OUTPUT_RGB };
    let Some(mut worker) = workers::open(hosts, at, options.at(), outputs, u)? else { return Ok(()) };
    let mut points = ffi::Points {
        struct_size: size_of::<ffi::Points>(),
        count: said(n, u)?,
        positions: positions.lent(),
        dirs: if colour || u.arbitrary()? { dirs.lent() } else { lent(None) },
        sigma: if rarely(u, 64)? { call::NO_PLANE } else { sigma.plane },
        rgb: if colour { rgb.plane } else { call::NO_PLANE },
    };
    let taken = n > 0 && rarely(u, 24)?;
    if taken {
        let [one, two, three] = worker.places(hosts, u)?;
        let own: *mut c_void = points.positions.data.cast_mut().cast();
        let place = *u.choose(&[one, two, three, own])?;
        points.sigma.data = place.wrapping_byte_add(place.align_offset(4));
    }
    let (mut points, handle) = (Lent::new(&points, u)?, worker.handle(u)?);
    let (mut counters, mut message) = (Lent::new(&call::counters(), u)?, Message::new(u)?);
    let (text, capacity) = (message.at(), message.0.size());
    // SAFETY: worker and scenes are intact and everything lives until the call returns.
    let status = unsafe { ffi::nerf_query(handle, points.at(), counters.at(), text, capacity) };
    message.check(status);
    worker.check(status);
    assert!(positions.is_untouched() && dirs.is_untouched(), "{status:?}: what is read was written to");
    assert!(status == Status::Ok || counters.is_untouched(), "{status:?}: counters were written");
    if taken {
        assert!(status != Status::Ok, "densities lie where they must not");
        return Ok(());
    }
    let sound = |value: f32| value >= 0.0;
    sigma.check(status, false, sound);
    if colour {
        rgb.check(status, false, sound);
    } else {
        assert!(rgb.memory.is_untouched(), "{status:?}: colours that nobody asked for");
    }
    Ok(())
}

/// Rays from anywhere: what each sees, or where it collides.
pub fn rays(hosts: &[Host], at: usize, u: &mut Unstructured<'_>) -> Result<()> {
    let (n, collide, garbage) = (u.int_in_range(0..=40usize)?, u.arbitrary::<bool>()?, u.ratio(1, 4)?);
    let mut drawing = Drawing::of(u, (n as u32, 1), false)?;
    let [mut origins, mut dirs, mut t_min, mut t_max, mut random] = [const { Vec::new() }; 5];
    for _ in 0..n {
        let wrong = garbage && rarely(u, 16)?;
        let origin = any_vec3(u)?;
        origins.extend(origin.map(|x| if x.is_finite() || wrong { x } else { 1e30 }));
        dirs.extend(direction(garbage, u)?);
        let (near, far, number) = (any_f32(u)?, any_f32(u)?, any_f32(u)?);
        let (low, far) = if near <= far || wrong { (near, far) } else { (far, near) };
        t_min.push(if low >= 0.0 || wrong { low } else { 0.0 });
        t_max.push(if far >= 0.0 || wrong { far } else { f32::INFINITY });
        random.push(if (0.0..1.0).contains(&number) || wrong { number } else { 0.25 });
    }
    let (origins, dirs) = (Numbers::new(&origins, 3, u)?, Numbers::new(&dirs, 3, u)?);
    let maybe = |values: &[f32], wanted: bool, u: &mut Unstructured<'_>| {
        Ok(if wanted { Some(Numbers::new(values, 1, u)?) } else { None })
    };
    let (near, far, numbers) = (u.arbitrary()?, u.arbitrary()?, collide != rarely(u, 16)?);
    let (t_min, t_max) = (maybe(&t_min, near, u)?, maybe(&t_max, far, u)?);
    let random = maybe(&random, numbers, u)?;
    let axis = direction(garbage, u)?;
    let Some(mut worker) = drawing.worker(hosts, at, u)? else { return Ok(()) };
    let taken = n > 0 && rarely(u, 24)?;
    if taken {
        let [one, two, three] = worker.places(hosts, u)?;
        drawing.lay_over(&[one, two, three, dirs.lent().data.cast_mut().cast()], u)?;
    }
    if rarely(u, 64)?
        && let Some(plane) = drawing.surfaces.iter().flatten().next()
    {
        drawing.target.limit_z_depth = ffi::Plane { format: ffi::PixelFormat::F32 as u32, ..plane.plane };
    }
    let mut target = Lent::new(&drawing.target, u)?;
    let rays = ffi::Rays {
        struct_size: size_of::<ffi::Rays>(),
        count: said(n, u)?,
        origins: if rarely(u, 64)? { lent(None) } else { origins.lent() },
        dirs: dirs.lent(),
        t_min: lent(t_min.as_ref()),
        t_max: lent(t_max.as_ref()),
        random: lent(random.as_ref()),
        axis: if u.ratio(1, 8)? { null() } else { axis.as_ptr() },
        target: target.at(),
    };
    let (mut rays, handle) = (Lent::new(&rays, u)?, worker.handle(u)?);
    let (mut counters, mut message) = (Lent::new(&call::counters(), u)?, Message::new(u)?);
    let (text, capacity) = (message.at(), message.0.size());
    let call = if collide { ffi::nerf_sample_rays } else { ffi::nerf_render_rays };
    // SAFETY: worker and scenes are intact and everything lives until the call returns.
    let status = unsafe { call(handle, rays.at(), counters.at(), text, capacity) };
    message.check(status);
    worker.check(status);
    let read = [Some(&origins), Some(&dirs), t_min.as_ref(), t_max.as_ref(), random.as_ref()];
    assert!(read.into_iter().flatten().all(Numbers::is_untouched), "{status:?}: what is read was written to");
    assert!(status == Status::Ok || counters.is_untouched(), "{status:?}: counters were written");
    if taken {
        assert!(status != Status::Ok, "a plane lies where it must not");
        return Ok(());
    }
    // Where nothing is met, a distance may be infinite.
    drawing.check(status, false, |value| !value.is_nan());
    if let (Status::Ok, Some(opacity)) = (status, &drawing.surfaces[1]) {
        let sound = |value: &f32| (0.0..=1.0).contains(value) && !(collide && value.fract() > 0.0);
        assert!(opacity.floats().iter().all(sound), "an opacity that is none");
    }
    Ok(())
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
