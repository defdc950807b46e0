//! The caller's own rays: rendering, and sampling of the points at which photons collide.

use crate::boundary::{Message, by_width, call, versioned};
use crate::camera::read_vec3;
use crate::counters::Counters;
use crate::failure::Failure;
use crate::pixel::Channel;
use crate::span::{Pieces, Span, check_aligned};
use crate::status::Status;
use crate::target::{Canvas, Target};
use crate::worker::{State, Worker, with_worker_and};
use core::ffi::c_char;
use nerf_core::camera::Ray;
use nerf_core::render::RaySegment;
use nerf_core::volume::Pixel;

/// Array in the caller's memory, with one element per ray or point: a float, or the three floats of a vector (x, y, z).
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Floats {
    /// Address of the first element.
    pub data: *const f32,
    /// Bytes from the start of an element to the start of the next one; 0 if elements are contiguous.
    pub stride: usize,
}

impl Floats {
    /// Checks an array of `count` elements; an element has as many floats as the argument `each` says. Returns the
    /// checked array, and the memory range of its elements. Returns an error that contains `name` if the address is
    /// NULL, if address or stride is misaligned, if the stride is shorter than an element, or if the size overflows.
    pub(crate) fn check(
        &self,
        name: &'static str,
        count: usize,
        each: usize,
    ) -> Result<(Numbers, Pieces), Failure> {
        let size = each * size_of::<f32>();
        let stride = if self.stride == 0 { size } else { self.stride };
        let numbers = Numbers { data: self.data.cast(), stride };
        if count == 0 {
            return Ok((numbers, Pieces::NONE));
        }
        Span::of(name, self.data, 0)?;
        check_aligned(name, stride, align_of::<f32>())?;
        if stride < size {
            return Err(Failure::Stride { name, expected: size, found: stride });
        }
        let length = (count - 1).checked_mul(stride).and_then(|bytes| bytes.checked_add(size));
        let span = Span::new(name, self.data.cast(), length.ok_or(Failure::Overflow(name))?)?;
        Ok((numbers, Pieces { span, stride, size }))
    }
}

/// An array that [`Floats::check`] has checked.
#[derive(Clone, Copy)]
pub(crate) struct Numbers {
    data: *const u8,
    stride: usize,
}

impl Numbers {
    /// Returns element `i`, which has `EACH` floats.
    /// # Safety
    /// [`Floats::check`] accepted the array for elements of `EACH` floats and for a `count` above `i`. The memory is
    /// readable.
    #[inline]
    pub unsafe fn at<const EACH: usize>(&self, i: usize) -> [f32; EACH] {
        // SAFETY: the element lies in the checked array, and is aligned; the caller vouches for the memory.
        unsafe { self.data.add(i * self.stride).cast::<[f32; EACH]>().read() }
    }
}

/// Rays of the caller, with any origins, in any order.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Rays {
    /// `sizeof(nerf_rays)`.
    pub struct_size: usize,
    /// Number of rays; every array below has one element per ray.
    pub count: usize,
    /// Origin of each ray: x, y, z, world space.
    pub origins: Floats,
    /// Direction of each ray: x, y, z, of unit length (squared length within 1e-3 of 1). Directions are not normalised
    /// again: a ray's distances are in units of its direction's length.
    pub dirs: Floats,
    /// Distance along each ray at which visibility begins, world units, at least 0; `data` NULL for 0. In a bounded
    /// scene with a fixed step, a change of `t_min` can move all samples: the first sample interval begins at `t_min`
    /// or where the ray enters the box, whichever is farther. These are the scenes whose `nerf_scene_info` has a `step`
    /// other than 0 and a `contraction_radius` of 0. In every other scene, `t_min` moves no sample, but cuts the sample
    /// interval that contains `t_min`.
    pub t_min: Floats,
    /// Distance along each ray at which visibility ends, world units, at least `t_min`, may be infinite; `data` NULL
    /// for no end. `t_max` cuts the sample interval that contains it: opacity is a continuous function of `t_max`.
    pub t_max: Floats,
    /// One random number in [0, 1) per ray for `nerf_sample_rays`; `data` NULL for `nerf_render_rays`. A 1, which
    /// rounding to float can produce, is replaced by the largest float below 1.
    pub random: Floats,
    /// Axis along which `z_depth` is measured: three floats, unit length like `dirs`. A camera's axis is the direction
    /// of the ray through the principal point. May be NULL if the target has no plane `z_depth`.
    pub axis: *const f32,
    /// Planes for the results: one row of `count` pixels; `row_stride` is ignored. A ray and its results may be fields
    /// of one structure. `data` of `limit_ray_distance` and `limit_z_depth` must be NULL: `t_max` ends a ray instead.
    pub target: *const Target,
}

versioned!(unsafe Rays, "rays", by_width(56, 112));

/// Renders the caller's own rays: ray i is pixel i of the target.
///
/// A ray may begin outside, inside or behind the scene. A ray with an opacity of at most 1e-4 counts as meeting no
/// surface. The distances of this ray are then the smallest of three values. The first is `t_max`. The second is
/// `far_distance` of the options, ignored if 0. The third is an upper bound, computed from the scene's extent, on the
/// distance from the ray's origin to any visible point. Without jitter, the rays of a camera's pixels give the camera's
/// image, bit for bit. For shadow rays, render the opacity alone, which is less work: the opacity is the same with and
/// without other planes.
///
/// All rays are checked before the first result is written. Returns `NERF_STATUS_RAY` if `random` is set, or if a
/// ray has an origin that is not finite, a direction that is not of unit length, or a `t_min` that is infinite, below 0
/// or above `t_max`; the message names the first such ray. Returns `NERF_STATUS_OPTIONS` for anti-aliasing or an
/// aperture, which belong to cameras. `counters`: NULL, or receives counts of the work on success. `message`: NULL, or
/// a buffer for an error message.
///
/// # Safety
/// Pointers are NULL or point to what is described here. The caller has not freed, moved or overwritten the memory of
/// `worker` or its scenes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_render_rays(
    worker: *mut Worker,
    rays: *const Rays,
    counters: *mut Counters,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        unsafe { trace(worker, rays, counters, false) }
    })
}

/// Samples the point on each ray at which a photon collides with the medium, for path tracers.
///
/// A ray's photon collides where the opacity accumulated along the ray reaches the ray's number in `random`. A ray with
/// a collision has opacity 1, the distance to the collision, and the field's colour and normal at the collision. A ray
/// without a collision has opacity 0, infinite distances, and the background's colour (0 in RGBA planes). Cuts in the
/// options are ignored. A number outside [0, 1] gives `NERF_STATUS_RAY`. All else is as in `nerf_render_rays`.
///
/// If a ray is sampled often, with uniform random numbers, the means converge to the results of `nerf_render_rays`
/// without cuts. Opacity and colour are averaged over all results. Distance and normal are averaged over the results
/// with a collision. The mean distance equals the rendered distance to within one sample interval. The mean normal has
/// the direction of the rendered normal. In a scene with deferred shading, the mean colour differs from the rendered
/// colour: `nerf_render_rays` evaluates the colour branch once per ray, from composited features; `nerf_sample_rays`
/// evaluates the branch at the collision's sample alone.
///
/// # Safety
/// Pointers are NULL or point to what `nerf_render_rays` describes. The caller has not freed, moved or overwritten the
/// memory of `worker` or its scenes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_sample_rays(
    worker: *mut Worker,
    rays: *const Rays,
    counters: *mut Counters,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        unsafe { trace(worker, rays, counters, true) }
    })
}

/// Checked input arrays of rays. `read`: name and memory of each array, for errors about outputs that overlap it.
struct Arrays {
    origins: Numbers,
    dirs: Numbers,
    t_min: Option<Numbers>,
    t_max: Option<Numbers>,
    random: Option<Numbers>,
    read: [(&'static str, Pieces); 5],
}

impl Arrays {
    fn of(rays: &Rays, collide: bool) -> Result<Self, Failure> {
        let count = rays.count;
        let (origins, of_origins) = rays.origins.check("rays.origins", count, 3)?;
        let (dirs, of_dirs) = rays.dirs.check("rays.dirs", count, 3)?;
        let optional = |name: &'static str, floats: &Floats, needed: bool| {
            if floats.data.is_null() && !needed {
                return Ok((None, (name, Pieces::NONE)));
            }
            floats.check(name, count, 1).map(|(numbers, pieces)| (Some(numbers), (name, pieces)))
        };
        let (t_min, of_t_min) = optional("rays.t_min", &rays.t_min, false)?;
        let (t_max, of_t_max) = optional("rays.t_max", &rays.t_max, false)?;
        if !collide && !rays.random.data.is_null() {
            return Err(Failure::RandomOfRendered);
        }
        let (random, of_random) = optional("rays.random", &rays.random, collide)?;
        let read = [("rays.origins", of_origins), ("rays.dirs", of_dirs), of_t_min, of_t_max, of_random];
        Ok(Self { origins, dirs, t_min, t_max, random, read })
    }

    /// Returns ray `i`. Without an array of `t_min`, `t_min` is 0; without an array of `t_max`, `t_max` is infinity.
    ///
    /// # Safety
    /// As for [`Numbers::at`].
    #[inline]
    unsafe fn ray(&self, i: usize) -> RaySegment {
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        unsafe {
            RaySegment {
                ray: Ray { origin: self.origins.at::<3>(i).into(), dir: self.dirs.at::<3>(i).into() },
                t_min: self.t_min.map_or(0.0, |t| t.at::<1>(i)[0]),
                t_max: self.t_max.map_or(f32::INFINITY, |t| t.at::<1>(i)[0]),
            }
        }
    }
}

/// Renders rays or, if `collide` is true, samples the point on each ray at which a photon collides with the medium.
///
/// # Safety
/// As for [`nerf_render_rays`].
#[inline]
unsafe fn trace(
    worker: *mut Worker,
    rays: *const Rays,
    counters: *mut Counters,
    collide: bool,
) -> Result<(), Failure> {
    let draw = |worker: &mut State, rays: Rays| {
        worker.fields()?;
        let arrays = Arrays::of(&rays, collide)?;
        let axis = if rays.axis.is_null() {
            None
        } else {
            // SAFETY: the axis is valid, as this function's `# Safety` requires.
            Some(unsafe { read_vec3("rays.axis", rays.axis)? })
        };
        // SAFETY: `target` and its planes are valid, as this function's `# Safety` requires.
        let mut canvas =
            unsafe { Canvas::of_target(rays.target, (rays.count, 1), Some(&arrays.read), worker)? };
        canvas.set_up(worker)?;
        if canvas.has(Channel::ZDepth) && axis.is_none() {
            return Err(Failure::Null("rays.axis"));
        }
        // SAFETY: `Arrays::of` verified that the arrays hold every ray; the caller vouches for their memory.
        let ray = |i: usize| unsafe { arrays.ray(i) };
        // SAFETY: `Arrays::of` verified that the array holds every number; the caller vouches for its memory.
        let number = |i: usize| arrays.random.map_or(0.0, |random| unsafe { random.at::<1>(i)[0] });
        let fields = worker.fields()?;
        let mut put = |i: usize, pixel: &Pixel| canvas.put(i, pixel);
        Ok(if collide {
            fields.sample_rays_with(rays.count, &ray, &number, axis, &mut put)?
        } else {
            fields.render_rays_with(rays.count, &ray, axis, &mut put)?
        })
    };
    // SAFETY: the arguments are valid, as this function's `# Safety` requires.
    unsafe { with_worker_and(worker, rays, counters, draw) }
}
