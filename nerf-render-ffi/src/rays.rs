//! Rays of the caller's own: what each sees, and where a photon on it collides.

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

/// Numbers of the caller's, one or three to each ray or point.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Floats {
    /// The first of them.
    pub data: *const f32,
    /// Bytes from one ray's or point's to the next; 0 for side by side.
    pub stride: usize,
}

impl Floats {
    /// `count` groups of `each` numbers, checked.
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

/// Numbers whose extent was checked.
#[derive(Clone, Copy)]
pub(crate) struct Numbers {
    data: *const u8,
    stride: usize,
}

impl Numbers {
    /// The `i`-th.
    ///
    /// # Safety
    /// `i` is below the count that was checked, and the caller's memory is readable.
    #[inline]
    pub unsafe fn one(&self, i: usize) -> f32 {
        // SAFETY: inside of what was checked, and aligned; the caller vouches for the memory.
        unsafe { self.data.add(i * self.stride).cast::<f32>().read() }
    }

    /// The `i`-th three.
    ///
    /// # Safety
    /// That of [`Numbers::one`].
    #[inline]
    pub unsafe fn three(&self, i: usize) -> [f32; 3] {
        // SAFETY: inside of what was checked, and aligned; the caller vouches for the memory.
        unsafe { self.data.add(i * self.stride).cast::<[f32; 3]>().read() }
    }
}

/// Rays of the caller's own, in any order, from anywhere.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Rays {
    /// `sizeof(nerf_rays)`.
    pub struct_size: usize,
    /// Number of them.
    pub count: usize,
    /// The origin of each, x, y, z.
    pub origins: Floats,
    /// The direction of each, x, y, z, of unit length: the square of its length is 1 within 1e-3. It is used as
    /// it is, so that distances are off by as much.
    pub dirs: Floats,
    /// The distance from which on a ray sees, world units along it, at least 0; NULL for 0. The samples of a scene that is
    /// marched (`step` of `nerf_scene_info` is not 0) are counted from here, so that another `t_min` moves all of them;
    /// those of another scene stay where they are, and the one whose bin `t_min` lies in counts for what is left of the
    /// bin.
    pub t_min: Floats,
    /// The distance up to which a ray sees, at least `t_min`, may be infinite; NULL for no end. It cuts the bin it lies in:
    /// opacity goes continuously with it.
    pub t_max: Floats,
    /// One random number in [0, 1) a ray for `nerf_sample_rays`; NULL for `nerf_render_rays`. 1 is taken for the largest
    /// float below 1, since rounding to float produces it.
    pub random: Floats,
    /// Three numbers, of unit length as `dirs` are: what `z_depth` is measured along, of a camera the direction of its ray
    /// through (cx, cy). NULL where that is not asked for.
    pub axis: *const f32,
    /// The target of the results: planes of one row of `count` pixels, of which only `pixel_stride` matters. They may be
    /// fields of the structures that the rays are in. No limits: `t_max` is the ray's.
    pub target: *const Target,
}

versioned!(unsafe Rays, "rays", by_width(56, 112));

/// Renders rays of the caller's own: each is a pixel of the target.
///
/// A ray may begin anywhere: outside of the scene, inside, behind it. Where it meets no surface, distances are one that is
/// beyond everything in the scene, or `t_max`. The rays of a camera give its pixels, bit for bit, without jitter. A plane of
/// opacity alone is what a shadow ray needs: the same bits as beside others, for less work.
///
/// Rays are checked before the first result is written: `NERF_STATUS_RAY` names the first that has an origin that is not
/// finite, a direction that is not of unit length or an empty range; it is also the status of `random` that is not NULL.
/// Options with anti-aliasing or an aperture, which belong to cameras, are `NERF_STATUS_OPTIONS`. `counters` and `message`:
/// as in `nerf_render`.
///
/// # Safety
/// Pointers are NULL or point to what is described here; `worker` and its scenes are intact.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_render_rays(
    worker: *mut Worker,
    rays: *const Rays,
    counters: *mut Counters,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: the arguments are as this function's `# Safety` has them.
        unsafe { trace(worker, rays, counters, false) }
    })
}

/// Draws where a photon that flies along each ray collides with the field: for path tracers.
///
/// A ray collides where its opacity reaches its number of `random`. Then `opacity` is 1, the distances are that point's, and
/// colour and normal are the field's there. Else opacity is 0, distances are infinite, and colour is the background (0 in
/// RGBA planes). Over uniform numbers the mean of the colours is what `nerf_render_rays` composites without cuts, which are
/// not used here. Of a field shaded once a ray it is not: a colour is that of the field's network for one sample by itself.
/// The means of opacity, distance and normal are; the field's own colour is that of `nerf_render_rays` of the same ray.
/// `NERF_STATUS_RAY` also where a number is not in [0, 1]. The rest as in `nerf_render_rays`.
///
/// # Safety
/// Pointers are NULL or point to what is described there; `worker` and its scenes are intact.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_sample_rays(
    worker: *mut Worker,
    rays: *const Rays,
    counters: *mut Counters,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: the arguments are as this function's `# Safety` has them.
        unsafe { trace(worker, rays, counters, true) }
    })
}

/// The arrays of a call, checked, and where they lie.
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

    /// The `i`-th ray.
    ///
    /// # Safety
    /// That of [`Numbers::one`].
    #[inline]
    unsafe fn ray(&self, i: usize) -> RaySegment {
        // SAFETY: the caller's promise.
        unsafe {
            RaySegment {
                ray: Ray { origin: self.origins.three(i).into(), dir: self.dirs.three(i).into() },
                t_min: self.t_min.map_or(0.0, |t| t.one(i)),
                t_max: self.t_max.map_or(f32::INFINITY, |t| t.one(i)),
            }
        }
    }
}

/// Renders rays, or draws where photons on them collide.
///
/// # Safety
/// That of [`nerf_render_rays`].
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
            // SAFETY: the axis is as this function's `# Safety` has it.
            Some(unsafe { read_vec3("rays.axis", rays.axis)? })
        };
        // SAFETY: `target` and its planes are as this function's `# Safety` has them.
        let mut canvas = unsafe { Canvas::of_rays(rays.target, rays.count, &arrays.read, worker)? };
        canvas.set_up(worker)?;
        if canvas.has(Channel::ZDepth) && axis.is_none() {
            return Err(Failure::Null("rays.axis"));
        }
        // SAFETY: all of them were found inside of arrays that the caller vouches for.
        let ray = |i: usize| unsafe { arrays.ray(i) };
        // SAFETY: as above.
        let number = |i: usize| arrays.random.map_or(0.0, |random| unsafe { random.one(i) });
        let fields = worker.fields()?;
        let mut put = |i: usize, pixel: &Pixel| canvas.put(i, pixel);
        Ok(if collide {
            fields.sample_rays_with(rays.count, &ray, &number, axis, &mut put)?
        } else {
            fields.render_rays_with(rays.count, &ray, axis, &mut put)?
        })
    };
    // SAFETY: the caller's promise.
    unsafe { with_worker_and(worker, rays, counters, draw) }
}
