//! Cameras: image size, lens, pose, and the ray through an image point.

use crate::boundary::{
    Message, Out, by_width, call, check_out, check_zeros, named, read_versioned, versioned,
};
use crate::failure::Failure;
use crate::span::Span;
use crate::status::Status;
use core::ffi::c_char;
use glam::Vec3;
use nerf_core::camera::{self, Intrinsics, Lens, Pose, Projection};

/// Lens model of a `nerf_camera`. The model determines what the distortion coefficients mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum LensModel {
    /// Perspective camera with the distortion of OpenCV. COLMAP's model OPENCV has the coefficients `k1 k2 p1 p2`.
    /// COLMAP's model FULL_OPENCV has all eight coefficients, `k1` to `k6`, `p1` and `p2`. `k4 k5 k6` are in the
    /// denominator of the radial factor.
    RadialTangential = 0,
    /// Fisheye, COLMAP's OPENCV_FISHEYE: a ray at angle `t` (radians) to the view axis meets the image at a distance of
    /// `t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)` focal lengths from the principal point; `k5 k6 p1 p2` must be 0.
    Fisheye = 1,
}

const PROJECTIONS: [Option<Projection>; 2] = [Some(Projection::Perspective), Some(Projection::Fisheye)];

/// A perspective or fisheye camera. The camera looks down −Z, +Y is up, +X is right, as in OpenGL.
///
/// Pixel (0, 0) is top left and its centre is at (0.5, 0.5).
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Camera {
    /// `sizeof(nerf_camera)`.
    pub struct_size: usize,
    /// Image width, pixels, at most 8,388,608 (2^23).
    pub width: u32,
    /// Image height, pixels, at most 8,388,608 (2^23).
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f32,
    /// Focal length along y, pixels.
    pub fy: f32,
    /// Principal point, pixels from the left edge; usually width / 2.
    pub cx: f32,
    /// Principal point, pixels from the top edge; usually height / 2.
    pub cy: f32,
    /// Radial distortion: coefficient of r^2 (fisheye: of angle^2), as in OpenCV; 0 for none.
    pub k1: f32,
    /// Radial distortion: coefficient of r^4 (fisheye: of angle^4); 0 for none.
    pub k2: f32,
    /// First coefficient of tangential distortion, as in OpenCV; 0 for none. Must be 0 for a fisheye.
    pub p1: f32,
    /// Second coefficient of tangential distortion, as in OpenCV; 0 for none. Must be 0 for a fisheye.
    pub p2: f32,
    /// Camera-to-world transform: the upper three rows of the 4x4 matrix, row-major. The rotation's columns are right,
    /// up, backward; `c2w[3]`, `c2w[7]`, `c2w[11]` are the camera's centre, world units.
    pub c2w: [f32; 12],
    /// Radial distortion: coefficient of r^6 (fisheye: of angle^6); 0 for none.
    pub k3: f32,
    /// Coefficient of r^2 in the denominator of the radial factor; for a fisheye, coefficient of angle^8. 0 for none.
    pub k4: f32,
    /// Coefficient of r^4 in the denominator of the radial factor; 0 for none. Must be 0 for a fisheye.
    pub k5: f32,
    /// Coefficient of r^6 in the denominator of the radial factor; 0 for none. Must be 0 for a fisheye.
    pub k6: f32,
    /// Lens model: a `nerf_lens_model`; 0 is a perspective camera.
    pub lens_model: u32,
    /// Reserved; must be 0.
    pub reserved: u32,
}

versioned!(unsafe Camera, "camera", by_width(116, 120));

impl Camera {
    /// Reads and checks the camera at `at`, and converts the camera to the renderer's type.
    /// # Safety
    /// `at` is NULL or points to `struct_size` readable bytes.
    pub(crate) unsafe fn read(at: *const Self) -> Result<camera::Camera, Failure> {
        // SAFETY: `at` is valid, as this function's `# Safety` requires.
        let c = unsafe { read_versioned(at)? };
        check_zeros("camera.reserved", &[c.reserved])?;
        let projection = named(&PROJECTIONS, "camera.lens_model", "a nerf_lens_model", c.lens_model)?;
        let Self { width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6, .. } = c;
        let row = |i: usize| core::array::from_fn(|j| c.c2w[4 * i + j]);
        let pose = Pose::from_rows([row(0), row(1), row(2)]);
        let intrinsics = Intrinsics { width, height, fx, fy, cx, cy };
        let lens = Lens { k1, k2, p1, p2, k3, k4, k5, k6, projection };
        Ok(camera::Camera::new(intrinsics, lens, pose)?)
    }
}

/// Returns the three floats at `at`; an error that contains `name` if `at` is NULL or misaligned.
/// # Safety
/// `at` is NULL or points to three floats.
pub(crate) unsafe fn read_vec3(name: &'static str, at: *const f32) -> Result<Vec3, Failure> {
    Span::of(name, at, 3)?;
    // SAFETY: `at` is not NULL and is aligned; three floats are readable, as this function's `# Safety` requires.
    Ok(Vec3::from_array(unsafe { at.cast::<[f32; 3]>().read() }))
}

/// Places a camera at `eye`, looking at `target`; the direction `up` points upwards in the image.
///
/// `camera`: the caller sets `struct_size`; the other fields may have any values. The call writes only `c2w`, and only
/// on success. `eye`, `target`, `up`: three floats each, world units; `up` may have any length. `message`: NULL, or a
/// buffer for an error message. Returns `NERF_STATUS_CAMERA` if `eye` equals `target`, if `up` is 0 or parallel to the
/// view axis, or if a float is not finite.
///
/// # Safety
/// Pointers are NULL or point to what is described here.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_camera_look_at(
    camera: *mut Camera,
    eye: *const f32,
    target: *const f32,
    up: *const f32,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: `camera` is NULL or readable and writable, as this function's `# Safety` requires.
        let (mut turned, place) = unsafe { (read_versioned(camera.cast_const())?, Out::new(camera)?) };
        // SAFETY: the three vectors are NULL or readable, as this function's `# Safety` requires.
        let [eye, target, up] =
            unsafe { [read_vec3("eye", eye)?, read_vec3("target", target)?, read_vec3("up", up)?] };
        let rows = Pose::look_at(eye, target, up).ok_or(Failure::NoView)?.to_rows();
        turned.c2w = core::array::from_fn(|k| rows[k / 4][k % 4]);
        place.write(turned);
        Ok(())
    })
}

/// Computes the ray through an image point, for example to evaluate points on the ray with `nerf_query`.
///
/// `x`, `y`: image point, pixels from left and top; pixel (0, 0) has its centre at (0.5, 0.5). The point may lie
/// outside the image. `origin`, `dir`: three floats each, world space; `dir` has unit length and takes account of the
/// lens distortion. `z_per_distance`: NULL, or receives the cosine of the angle between ray and view axis; a distance
/// along the ray times this cosine is the distance along the view axis. Results are written on success only. Returns
/// `NERF_STATUS_CAMERA` if the direction overflows, if the distortion has no inverse at the image point, or if the
/// distorted image folds over itself between principal point and image point. `message`: NULL, or a buffer for an error
/// message.
///
/// # Safety
/// Pointers are NULL or point to what is described here.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_camera_ray(
    camera: *const Camera,
    x: f32,
    y: f32,
    origin: *mut f32,
    dir: *mut f32,
    z_per_distance: *mut f32,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: `camera` is valid, as this function's `# Safety` requires.
        let camera = unsafe { Camera::read(camera)? };
        check_out("origin", origin)?;
        check_out("dir", dir)?;
        if !z_per_distance.is_null() {
            check_out("z_per_distance", z_per_distance)?;
        }
        let ray = camera.try_ray(x, y).ok_or(Failure::NoRay { x, y })?;
        // SAFETY: the pointers were checked above, and are writable, as this function's `# Safety` requires.
        unsafe {
            origin.cast::<[f32; 3]>().write(ray.origin.to_array());
            dir.cast::<[f32; 3]>().write(ray.dir.to_array());
        }
        if !z_per_distance.is_null() {
            // SAFETY: `z_per_distance` was checked above, and is writable, as this function's `# Safety` requires.
            unsafe { z_per_distance.write(camera.z_per_distance(&ray)) };
        }
        Ok(())
    })
}
