//! Cameras, which map pixels to rays: intrinsics, lens distortion and camera-to-world pose.

mod lens;
mod pinhole;

pub use lens::{Lens, Projection};
pub(crate) use pinhole::PinholeRays;

use crate::errors::errors;
use crate::math::length;
use glam::{Mat3, Vec2, Vec3};

#[cfg(test)]
mod tests;

/// Maximum side of an image, pixels: up to this size the centre of every pixel is exact in f32.
pub const MAX_IMAGE_SIDE: u32 = 1 << 23;
/// Maximum distance of an image point from the principal point along x or y, in focal lengths. Up to this distance, the
/// square of the distance is well within the range of f32.
const MAX_NORMALISED: f32 = 1e9;

/// A half line in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start of the ray, world units.
    pub origin: Vec3,
    /// Direction, **unit length**, so that `t` in [`Ray::at`] is a distance in world units.
    pub dir: Vec3,
}

impl Ray {
    /// The point `origin + t * dir`.
    #[inline]
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.dir * t
    }
}

/// Whether `dir` has unit length: its squared length is 1 within 1e-3, loose enough for inexact normalisation.
pub fn is_unit(dir: Vec3) -> bool {
    (dir.length_squared() - 1.0).abs() <= 1e-3
}

/// Pinhole intrinsics, in pixels; pixel (0, 0) is top left and its centre is (0.5, 0.5).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f32,
    /// Focal length along y, pixels.
    pub fy: f32,
    /// Principal point, pixels from the left edge.
    pub cx: f32,
    /// Principal point, pixels from the top edge.
    pub cy: f32,
}

impl Intrinsics {
    /// Intrinsics with square pixels, focal length `focal` (pixels) and the principal point at the image centre.
    pub fn centred(width: u32, height: u32, focal: f32) -> Self {
        Self { width, height, fx: focal, fy: focal, cx: width as f32 / 2.0, cy: height as f32 / 2.0 }
    }
}

/// A camera-to-world transform. In camera coordinates, −Z is the view direction, +Y up, +X right (OpenGL, Blender).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Camera-to-world rotation: its columns are the camera's right, up and backward axes in world space, orthonormal.
    pub rotation: Mat3,
    /// Centre of projection, world units.
    pub position: Vec3,
}

impl Pose {
    /// Makes a pose from the upper three rows of a row-major camera-to-world matrix; does not check the matrix.
    pub fn from_rows(c2w: [[f32; 4]; 3]) -> Self {
        let column = |j: usize| Vec3::new(c2w[0][j], c2w[1][j], c2w[2][j]);
        Self { rotation: Mat3::from_cols(column(0), column(1), column(2)), position: column(3) }
    }

    /// Returns the upper three rows of the row-major camera-to-world matrix.
    pub fn to_rows(&self) -> [[f32; 4]; 3] {
        let (m, p) = (self.rotation, self.position);
        [
            [m.x_axis.x, m.y_axis.x, m.z_axis.x, p.x],
            [m.x_axis.y, m.y_axis.y, m.z_axis.y, p.y],
            [m.x_axis.z, m.y_axis.z, m.z_axis.z, p.z],
        ]
    }

    /// Returns the pose of a camera at `eye` that looks at `target`, with `up` pointing upwards in the image.
    ///
    /// `None` if `eye` equals `target`, if `up` is 0 or parallel to the line of sight (within 1e-4 rad, where the
    /// cross product is rounding noise), or if a component is infinite or NaN.
    pub fn look_at(eye: Vec3, target: Vec3, up: Vec3) -> Option<Self> {
        let backward = unit(eye - target)?;
        let side = unit(up)?.cross(backward);
        if length(side) < 1e-4 {
            return None;
        }
        let right = unit(side)?;
        Some(Self { rotation: Mat3::from_cols(right, backward.cross(right), backward), position: eye })
    }

    /// Checks that the coordinates of `position` are within ±1e9 and that `rotation` is a rotation within 1e-3.
    fn check(&self) -> Result<(), CameraError> {
        let position_fits = self.position.is_finite() && self.position.abs().max_element() <= 1e9;
        if !position_fits || !self.rotation.is_finite() {
            return Err(CameraError::PoseNotFinite);
        }
        let gram = self.rotation.transpose() * self.rotation;
        let (g, i) = (gram.to_cols_array(), Mat3::IDENTITY.to_cols_array());
        let off = g.iter().zip(i).fold(0.0f32, |worst, (a, b)| worst.max((a - b).abs()));
        let determinant = self.rotation.determinant();
        if off <= 1e-3 && determinant > 0.0 {
            Ok(())
        } else {
            Err(CameraError::PoseNotRotation { off, determinant })
        }
    }

    /// View direction of the camera: a unit vector in world space.
    pub fn forward(&self) -> Vec3 {
        // A pose is a rotation only within 1e-3, so that the axis needs normalisation.
        unit(-self.rotation.z_axis).unwrap_or_default()
    }
}

/// Returns `v` scaled to unit length; `None` if `v` is 0 or a component is infinite or NaN.
fn unit(v: Vec3) -> Option<Vec3> {
    // Scales `v` by a power of two, which is exact, before squares of its components can underflow or overflow.
    const UP: f32 = 1.267_650_6e30; // 2^100
    const DOWN: f32 = 8.271_806e-25; // 2^-80
    let size = v.abs().max_element();
    let scale = if size < 1e-15 {
        UP
    } else if size > 1e15 {
        DOWN
    } else {
        1.0
    };
    let v = v * scale;
    let inverse = 1.0 / length(v);
    (inverse > 0.0 && inverse.is_finite()).then(|| v * inverse)
}

/// A camera with checked parameters: every pixel has a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    intrinsics: Intrinsics,
    lens: Lens,
    pose: Pose,
}

impl Camera {
    /// Makes a camera from parts that are checked here, so that [`Camera::ray`] cannot fail.
    ///
    /// # Errors
    /// [`CameraError`] if one of these is found:
    /// - an image side of 0 or beyond [`MAX_IMAGE_SIDE`], or a focal length that is not positive and finite;
    /// - a principal point or a lens that is not finite, or a fisheye with a `p1`, `p2`, `k5` or `k6` other than 0;
    /// - a position with a coordinate outside ±1e9, or a rotation matrix that is not a rotation within 1e-3;
    /// - an image point more than 1e9 focal lengths off the principal point;
    /// - a lens that cannot be inverted at one of 17×17 image points;
    /// - a lens that folds (shows two directions at one image point) between the axis and the image border;
    /// - a lens with distortion in a build without the feature `lens`.
    pub fn new(intrinsics: Intrinsics, lens: Lens, pose: Pose) -> Result<Self, CameraError> {
        let Intrinsics { width, height, fx, fy, cx, cy } = intrinsics;
        if ![width, height].iter().all(|side| (1..=MAX_IMAGE_SIDE).contains(side)) {
            return Err(CameraError::ImageSize { width, height });
        }
        for (name, value) in [("fx", fx), ("fy", fy)] {
            if !(value > 0.0 && value.is_finite() && (1.0 / value).is_finite()) {
                return Err(CameraError::Focal { name, value });
            }
        }
        for (name, value) in [("cx", cx), ("cy", cy)] {
            if !value.is_finite() {
                return Err(CameraError::PrincipalPoint { name, value });
            }
        }
        for (name, value) in lens.coefficients() {
            if !value.is_finite() {
                return Err(CameraError::LensNotFinite { name, value });
            }
        }
        for (name, value) in [("p1", lens.p1), ("p2", lens.p2), ("k5", lens.k5), ("k6", lens.k6)] {
            if value != 0.0 && lens.projection == Projection::Fisheye {
                return Err(CameraError::LensNotOfFisheyes { name, value });
            }
        }
        pose.check()?;
        let camera = Self { intrinsics, lens, pose };
        camera.check_view()?;
        camera.check_lens()?;
        Ok(camera)
    }

    /// Checks that all points of the image are within [`MAX_NORMALISED`] focal lengths of the principal point along x
    /// and along y, so that squares of normalised image coordinates do not overflow.
    fn check_view(&self) -> Result<(), CameraError> {
        let (w, h) = (self.intrinsics.width as f32, self.intrinsics.height as f32);
        for (x, y) in [(0.0, 0.0), (w, h)] {
            let (u, v) = self.normalised(x, y);
            if !(u.abs() <= MAX_NORMALISED && v.abs() <= MAX_NORMALISED) {
                return Err(CameraError::FieldOfView { x, y });
            }
        }
        Ok(())
    }

    /// Checks that the lens can be inverted at 17×17 points over the image. For the points on the border, also checks
    /// that no fold lies between the axis and the point: past a fold, one image point shows two directions. A provably
    /// weak distortion passes untested. Without the feature `lens`, every distortion is an error.
    fn check_lens(&self) -> Result<(), CameraError> {
        if self.lens == Lens::NONE {
            return Ok(());
        }
        if !Lens::BUILT {
            return Err(CameraError::LensNotBuilt { lens: self.lens });
        }
        let (w, h) = (self.intrinsics.width as f32, self.intrinsics.height as f32);
        let [first, last] = [self.normalised(0.0, 0.0), self.normalised(w, h)].map(Vec2::from);
        if self.lens.is_gentle(first.abs().max(last.abs()).length()) {
            return Ok(());
        }
        for step in 0..=16u8 {
            let y = f32::from(step) / 16.0 * h;
            for step in 0..=16u8 {
                let x = f32::from(step) / 16.0 * w;
                let (u, v) = self.normalised(x, y);
                let border = [0.0, w].contains(&x) || [0.0, h].contains(&y);
                if self.lens.invert(u, v, border).is_none() {
                    return Err(CameraError::LensNotInvertible { x, y });
                }
            }
        }
        Ok(())
    }

    /// Returns a copy of this camera with the pose `pose`.
    ///
    /// # Errors
    /// [`CameraError`] unless the coordinates of the position are within ±1e9 and the matrix is a rotation within 1e-3.
    pub fn at(&self, pose: Pose) -> Result<Self, CameraError> {
        pose.check()?;
        Ok(Self { pose, ..*self })
    }

    /// Returns this camera in the coordinates of one instance's field. `pose`: camera-to-field transform, not checked.
    #[cfg(feature = "instances")]
    pub(crate) fn moved(&self, pose: Pose) -> Self {
        Self { pose, ..*self }
    }

    /// Image size, focal lengths and principal point, pixels.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// Projection and distortion coefficients of the lens.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// The camera-to-world transform.
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Normalised image coordinates (+y down) of the image point `(x, y)`, pixels.
    fn normalised(&self, x: f32, y: f32) -> (f32, f32) {
        let i = &self.intrinsics;
        ((x - i.cx) / i.fx, (y - i.cy) / i.fy)
    }

    /// Returns the ray through the image point `(x, y)`, in pixels; the centre of pixel (0, 0) is (0.5, 0.5).
    ///
    /// # Examples
    /// ```
    /// use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
    /// use glam::{Mat3, Vec3};
    /// let pose = Pose { rotation: Mat3::IDENTITY, position: Vec3::new(0.0, 0.0, 4.0) };
    /// let camera = Camera::new(Intrinsics::centred(2, 2, 1.0), Lens::NONE, pose)?;
    /// // The image centre is straight ahead, down −Z; a pixel to the right is at 45 degrees.
    /// assert_eq!(camera.ray(1.0, 1.0).dir, Vec3::NEG_Z);
    /// assert!((camera.ray(2.0, 1.0).dir - Vec3::new(0.5f32.sqrt(), 0.0, -0.5f32.sqrt())).length() < 1e-7);
    /// # Ok::<(), nerf_core::camera::CameraError>(())
    /// ```
    pub fn ray(&self, x: f32, y: f32) -> Ray {
        let (u, v) = self.normalised(x, y);
        self.towards(self.lens.straighten(u, v))
    }

    /// Returns the ray from the camera along `dir`. `dir`: camera coordinates (right, down, forward), of any length.
    fn towards(&self, dir: Vec3) -> Ray {
        let local = Vec3::new(dir.x, -dir.y, -dir.z);
        let dir = self.pose.rotation * local;
        Ray { origin: self.pose.position, dir: dir * (1.0 / length(dir)) }
    }

    /// Returns the ray through the image point `(x, y)`, pixels. The point may lie outside of the image, where
    /// [`Camera::new`] did not check the lens. `None` if the lens has no inverse at the point or folds between the axis
    /// and the point, or if the direction overflows f32.
    pub fn try_ray(&self, x: f32, y: f32) -> Option<Ray> {
        let (u, v) = self.normalised(x, y);
        let ray = self.towards(self.lens.invert(u, v, true)?);
        ray.dir.is_normalized().then_some(ray)
    }

    /// Projects a point of the world to an image point, pixels, which may lie outside of the image. `None` if the point
    /// is at the camera. With a perspective lens, also `None` if the point is not in front of the camera.
    pub fn project(&self, point: Vec3) -> Option<(f32, f32)> {
        let local = self.pose.rotation.transpose() * (point - self.pose.position);
        if local == Vec3::ZERO {
            return None;
        }
        let (u, v) = self.lens.project(Vec3::new(local.x, -local.y, -local.z))?;
        let i = &self.intrinsics;
        Some((i.cx + i.fx * u, i.cy + i.fy * v))
    }

    /// Returns a camera with one pixel per whole block of `right` × `down` pixels; the pixel's ray goes through the
    /// middle of the block. `right` is clamped to `1..=width` and `down` to `1..=height` of the image.
    pub fn thinned(&self, right: u32, down: u32) -> Self {
        let Intrinsics { width, height, fx, fy, cx, cy } = self.intrinsics;
        // `new` checked that no side is 0. `max(1)` lets the compiler see that `clamp` cannot panic.
        let (right, down) = (right.clamp(1, width.max(1)), down.clamp(1, height.max(1)));
        let (x, y) = (right as f32, down as f32);
        let intrinsics = Intrinsics {
            width: width / right,
            height: height / down,
            fx: fx / x,
            fy: fy / y,
            cx: cx / x,
            cy: cy / y,
        };
        // Needs no check: all directions lie within the view that `new` checked.
        Self { intrinsics, ..*self }
    }

    /// Ratio of `z_depth` to `ray_distance` on `ray`: the cosine of the angle between the ray and the view axis.
    pub fn z_per_distance(&self, ray: &Ray) -> f32 {
        ray.dir.dot(self.pose.forward())
    }
}

errors! {
    /// Reason why the parameters of a camera are invalid.
    CameraError:
    ImageSize { width: u32, height: u32 } =>
        "image size: expected sides of 1 to {MAX_IMAGE_SIDE} pixels, found {width}x{height}";
    Focal { name: &'static str, value: f32 } =>
        "{name}: expected a positive finite focal length in pixels, found {value}";
    PrincipalPoint { name: &'static str, value: f32 } =>
        "{name}: expected a finite principal point in pixels, found {value}";
    PoseNotFinite =>
        "camera-to-world pose: expected finite numbers and a position within 1e9, found otherwise";
    PoseNotRotation { off: f32, determinant: f32 } =>
        "camera-to-world pose: expected a rotation (|RtR - I| <= 1e-3, determinant 1), \
         found |RtR - I| = {off}, determinant {determinant}";
    FieldOfView { x: f32, y: f32 } =>
        "intrinsics: expected image points within {MAX_NORMALISED} focal lengths of the principal \
         point, found pixel ({x}, {y}) beyond";
    LensNotFinite { name: &'static str, value: f32 } =>
        "lens {name}: expected a finite number, found {value}";
    LensNotOfFisheyes { name: &'static str, value: f32 } =>
        "lens {name}: expected 0 in a fisheye, found {value}";
    LensNotInvertible { x: f32, y: f32 } =>
        "lens: expected a distortion that does not turn back up to pixel ({x}, {y}) of the image";
    LensNotBuilt { lens: Lens } => "lens: expected a build with the feature lens, or zeros, found {lens:?}";
}
