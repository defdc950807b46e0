//! The placement of a field in the world of the host application.

use crate::camera::{Camera, Pose, Ray};
use crate::errors::errors;
use glam::{Mat3, Vec3};

/// Tolerance of the test that a matrix, divided by its scale, is a rotation: largest difference of a column's length
/// from 1, and largest magnitude of the dot product of two columns.
const TOLERANCE: f32 = 1e-3;
/// Largest valid scale; the smallest valid scale is `1 / MAX_SCALE`. With a valid scale, distances in world and field
/// units stay in the range of f32.
const MAX_SCALE: f32 = 1e9;

/// Placement of a field in the host's world: rotation, uniform scale and translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    rotation: Mat3,
    scale: f32,
    translation: Vec3,
}

errors! {
    /// Reason why a matrix is no valid placement.
    #[derive(Eq)]
    PlacementError:
    NotFinite => "expected a rotation, one scale and a translation, found a number that is not finite";
    /// The scale, which is the mean length of the first three columns, is not in `[1e-9, 1e9]`.
    Singular => "expected a rotation, one scale and a translation, found a scale that is not in [1e-9, 1e9]";
    Sheared =>
        "expected a rotation, one scale and a translation, found axes of different lengths or not at right angles";
    Mirrored => "expected a rotation, one scale and a translation, found a mirrored one";
}

impl Placement {
    /// The placement at which the field's coordinates equal the world's.
    pub const IDENTITY: Self = Self { rotation: Mat3::IDENTITY, scale: 1.0, translation: Vec3::ZERO };

    /// Makes a placement from the upper three rows of a row-major field-to-world matrix.
    ///
    /// # Errors
    /// [`PlacementError`] if the matrix is not a rotation times a uniform scale, plus a translation.
    pub fn from_rows(to_world: [[f32; 4]; 3]) -> Result<Self, PlacementError> {
        if !to_world.iter().flatten().all(|x| x.is_finite()) {
            return Err(PlacementError::NotFinite);
        }
        let column = |c: usize| Vec3::new(to_world[0][c], to_world[1][c], to_world[2][c]);
        let axes = [column(0), column(1), column(2)];
        let lengths = axes.map(|axis| axis.length());
        let scale = (lengths[0] + lengths[1] + lengths[2]) / 3.0;
        if !(1.0 / MAX_SCALE..=MAX_SCALE).contains(&scale) {
            return Err(PlacementError::Singular);
        }
        let [x, y, z] = axes.map(|axis| axis / scale);
        let off = lengths.map(|length| (length / scale - 1.0).abs());
        let skew = [x.dot(y), y.dot(z), z.dot(x)].map(f32::abs);
        if off.into_iter().chain(skew).any(|error| error > TOLERANCE) {
            return Err(PlacementError::Sheared);
        }
        if x.cross(y).dot(z) < 0.0 {
            return Err(PlacementError::Mirrored);
        }
        // Orthogonalised, so that unit directions keep their length.
        let x = x.normalize();
        let z = x.cross(y).normalize();
        Ok(Self { rotation: Mat3::from_cols(x, z.cross(x), z), scale, translation: column(3) })
    }

    /// Number of world units per unit of the field's coordinates.
    pub fn scale(&self) -> f32 {
        self.scale
    }

    /// Transforms a point from the world's to the field's coordinates.
    pub fn point_in_field(&self, p: Vec3) -> Vec3 {
        self.rotation.transpose() * ((p - self.translation) / self.scale)
    }

    /// Transforms a unit direction from the world's to the field's coordinates.
    pub fn dir_in_field(&self, dir: Vec3) -> Vec3 {
        self.rotation.transpose() * dir
    }

    /// Transforms a ray from world to field coordinates; distances along the ray are divided by [`Placement::scale`].
    pub fn ray_in_field(&self, ray: &Ray) -> Ray {
        Ray { origin: self.point_in_field(ray.origin), dir: self.dir_in_field(ray.dir) }
    }

    /// Whether the scale is 1, up to rounding: distances are then equal in the field's and the world's coordinates.
    pub(crate) fn is_rigid(&self) -> bool {
        (self.scale - 1.0).abs() <= 1e-6
    }

    /// Transforms a camera from the world's to the field's coordinates.
    pub(crate) fn camera_in_field(&self, camera: &Camera) -> Camera {
        let Pose { rotation, position } = *camera.pose();
        let rotation = self.rotation.transpose() * rotation;
        camera.moved(Pose { rotation, position: self.point_in_field(position) })
    }

    /// Transforms a direction from the field's to the world's coordinates.
    pub fn dir_in_world(&self, dir: Vec3) -> Vec3 {
        self.rotation * dir
    }
}
