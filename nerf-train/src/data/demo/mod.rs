//! A small demo scene, with exact pictures and distances.
//!
//! The scene has shapes on a plinth without surroundings. They have checkers, stripes and marble, soft shadows, and
//! highlights that move with the camera, so that a field must model view-dependent colour. The scene fits into the box
//! [−1, 1]³ and has this crate's licence. All pictures are computed: equal [`DemoSpec`]s give equal bytes.

mod rounds;
mod shade;
mod shapes;

pub use rounds::two_rounds;

use crate::data::{Axes, Background, Dataset, Format, View};
use glam::{DVec3, Vec3};
use nerf_core::camera::{Camera, CameraError, Intrinsics, Lens, Pose};
use nerf_core::space::SceneBox;
use rayon::prelude::*;

/// Number of subsamples along each side of a pixel.
const SIDE: u32 = 3;

pub const SCENE_BOX: SceneBox = SceneBox { min: Vec3::NEG_ONE, max: Vec3::ONE };

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DemoSpec {
    pub train: u32,
    /// Number of validation views. Their cameras are in the same range of heights as the training cameras.
    pub val: u32,
    /// Side of the square pictures, pixels.
    pub size: u32,
    /// Distance of the cameras from the origin, world units. More than √3 puts all cameras outside of the scene box.
    pub radius: f32,
    /// Focal length divided by the picture's side; 1.3 shows the whole scene at the default radius.
    pub focal: f32,
}

impl Default for DemoSpec {
    fn default() -> Self {
        Self { train: 60, val: 8, size: 128, radius: 3.2, focal: 1.3 }
    }
}

impl DemoSpec {
    /// Makes a camera that looks at the origin. `azimuth`: radians, from +X to +Y. `z`: height / radius, within ±0.999.
    pub fn camera(&self, azimuth: f32, z: f32) -> Result<Camera, CameraError> {
        let z = z.clamp(-0.999, 0.999);
        let (sin, cos) = azimuth.sin_cos();
        let across = (1.0 - z * z).sqrt();
        let eye = self.radius * Vec3::new(across * cos, across * sin, z);
        let pose = Pose::look_at(eye, Vec3::ZERO, Vec3::Z).ok_or(CameraError::PoseNotFinite)?;
        let intrinsics = Intrinsics::centred(self.size, self.size, self.focal * self.size as f32);
        Camera::new(intrinsics, Lens::NONE, pose)
    }

    /// Makes `count` cameras on a golden spiral, from below the plinth to overhead. `phase`: first azimuth, radians.
    fn spiral(&self, count: u32, phase: f32) -> Result<Vec<Camera>, CameraError> {
        const GOLDEN_ANGLE: f32 = 2.399_963;
        let at = |i: u32| {
            let share = (i as f32 + 0.5) / count as f32;
            self.camera(phase + GOLDEN_ANGLE * i as f32, -0.35 + 1.27 * share)
        };
        (0..count).map(at).collect()
    }
}

pub fn dataset(spec: &DemoSpec) -> Result<Dataset, CameraError> {
    let shoot = |split: &str, cameras: Vec<Camera>| -> Vec<View> {
        let views = cameras.into_par_iter().enumerate();
        let view = |(i, camera)| View::new(format!("{split}/{i:03}"), camera, render(&camera));
        views.map(view).collect()
    };
    let (train, val) = (spec.spiral(spec.train, 0.0)?, spec.spiral(spec.val, 1.1)?);
    // Distance of the scene box's corners from the origin, which every camera looks at.
    let reach = 3.0f32.sqrt();
    Ok(Dataset {
        train: shoot("train", train),
        val: shoot("val", val),
        near: Some((spec.radius - reach).max(0.0)),
        far: Some(spec.radius + reach),
        background: Background::Alpha,
        ..Dataset::empty("demo".into(), Format::Demo, Axes::Opengl)
    })
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    pub ray_distance: f32,
    /// Depth of the hit along the camera's view axis, world units.
    pub z_depth: f32,
    pub normal: Vec3,
    /// Display-encoded sRGB colour of the surface, in [0, 1].
    pub rgb: [f32; 3],
}

/// Finds the first hit of the ray through the image point `(x, y)`, pixels (centres at half-integers); `None` without a
/// hit. Computed distances differ from the exact values by less than 1e-5 world units.
pub fn trace(camera: &Camera, x: f32, y: f32) -> Option<Hit> {
    let ray = camera.ray(x, y);
    let (origin, dir) = (ray.origin.as_dvec3(), ray.dir.as_dvec3().normalize());
    let found = shapes::first(origin, dir)?;
    let point = origin + dir * found.t;
    Some(Hit {
        ray_distance: found.t as f32,
        z_depth: (found.t * f64::from(camera.z_per_distance(&ray))) as f32,
        normal: found.normal.as_vec3(),
        rgb: shade::colour(found.shape, point, found.normal, dir),
    })
}

/// Ground truth of one picture; each field is `[height * width]`, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Straight-alpha sRGB, averaged over 3×3 subsamples in display space.
    pub rgba: Vec<[u8; 4]>,
    /// Distance along the ray through the pixel's centre, world units; `None` if the ray hits nothing.
    pub ray_distance: Vec<Option<f32>>,
    /// Depth of the hit along the camera's view axis, world units; `None` if the pixel's ray hits nothing.
    pub z_depth: Vec<Option<f32>>,
    /// Whether every subsample of the pixel hits the scene, so that no background shows in it.
    pub opaque: Vec<bool>,
}

pub fn render_truth(camera: &Camera) -> Truth {
    let centres: Vec<Option<Hit>> = per_pixel(camera, |x, y| trace(camera, x + 0.5, y + 0.5));
    let rgba = render(camera);
    Truth {
        opaque: rgba.iter().map(|pixel| pixel[3] == 255).collect(),
        rgba,
        ray_distance: centres.iter().map(|hit| hit.map(|hit| hit.ray_distance)).collect(),
        z_depth: centres.iter().map(|hit| hit.map(|hit| hit.z_depth)).collect(),
    }
}

fn render(camera: &Camera) -> Vec<[u8; 4]> {
    per_pixel(camera, |x, y| pixel(camera, x, y))
}

fn per_pixel<T: Send>(camera: &Camera, f: impl Fn(f32, f32) -> T + Sync) -> Vec<T> {
    let (width, height) = (camera.intrinsics().width, camera.intrinsics().height);
    let row = |y: u32| (0..width).map(|x| f(x as f32, y as f32)).collect::<Vec<T>>();
    (0..height).into_par_iter().flat_map_iter(row).collect()
}

/// Renders the pixel whose top left corner is the image point `(x, y)`, pixels, as straight-alpha sRGB.
fn pixel(camera: &Camera, x: f32, y: f32) -> [u8; 4] {
    let (mut sum, mut hits) = (Vec3::ZERO, 0u32);
    for index in 0..SIDE * SIDE {
        let offset = |i: u32| (i as f32 + 0.5) / SIDE as f32;
        if let Some(hit) = trace(camera, x + offset(index % SIDE), y + offset(index / SIDE)) {
            sum += Vec3::from(hit.rgb);
            hits += 1;
        }
    }
    let byte = |v: f32| (v * 255.0).round().clamp(0.0, 255.0) as u8;
    let [r, g, b] = (sum / hits.max(1) as f32).to_array().map(byte);
    [r, g, b, byte(hits as f32 / (SIDE * SIDE) as f32)]
}

/// Returns the distance from `point` to the nearest surface, world units, negative inside.
pub fn signed_distance(point: Vec3) -> f32 {
    let point: DVec3 = point.as_dvec3();
    shapes::SCENE.iter().map(|shape| shape.distance(point)).fold(f64::INFINITY, f64::min) as f32
}

/// A data set of `train` training and `val` validation views of `size` pixels a side.
#[cfg(test)]
pub(crate) fn small(train: u32, val: u32, size: u32) -> Dataset {
    dataset(&DemoSpec { train, val, size, ..DemoSpec::default() }).expect("a scene")
}

#[cfg(test)]
mod tests;
