//! Scene of the 3D page: cameras and rays to show, in world units.

use super::findings::Findings;
use super::sampling::{Drawer, ShownRay, StepFacts};
use crate::data::cameras::bundle::median;
use crate::data::pictures::thumbnail::{self, Thumbnail};
use crate::data::{Dataset, View};
use crate::model::config::Config;
use crate::train::{Bounds, find_bounds};
use anyhow::bail;
use glam::Vec3;
use nerf_core::camera::Camera;

/// Limit on the total number of samples in the `own_rays` of all cameras. This many samples take about a megabyte of
/// the page. Each camera may have four rays even if the limit is exceeded.
const OWN_SAMPLES: usize = 300_000;
/// Length of the drawn rays of an unbounded scene, in radii of the inner ball, which is not contracted.
const SHOWN_RADII: f32 = 2.0;
/// Smallest and largest depth of the frusta of an unbounded scene, in radii of the inner ball.
const FRUSTUM_RADII: (f32, f32) = (0.1, 0.35);

#[derive(Clone, Copy, Debug)]
pub struct Request<'v> {
    pub views: &'v [View],
    pub split: &'static str,
    /// Index in `views` of the only camera to show; `None`: all.
    pub camera: Option<usize>,
    /// Largest number of rays to show; 0: cameras only.
    pub rays: usize,
    pub step: u32,
    /// Up direction in world space; `None`: derived from the cameras.
    pub up: Option<Vec3>,
    /// Depth of the frusta along the view axis, world units; `None`: derived from the cameras' spacing.
    pub frustum: Option<f32>,
}

#[derive(Clone, Debug)]
pub struct Scene {
    pub name: String,
    pub split: &'static str,
    pub cameras: Vec<ShownCamera>,
    /// Rays that the training step draws from the shown views.
    pub rays: Vec<ShownRay>,
    pub alone: bool,
    pub step: StepFacts,
    pub bounds: Bounds,
    /// Up direction in world space, unit length.
    pub up: Vec3,
    /// Depth of the frusta along the view axis, world units.
    pub frustum: f32,
    pub axes: Axes,
    pub findings: Option<Findings>,
}

#[derive(Clone, Debug)]
pub struct ShownCamera {
    pub index: usize,
    pub name: String,
    pub camera: Camera,
    pub near: f32,
    pub thumbnail: Thumbnail,
    /// Rays that the training step would draw if this were its only view. Empty if the scene shows only this camera.
    pub own_rays: Vec<ShownRay>,
    /// Colour of the frustum, display-encoded; `None`: dark.
    pub colour: Option<[f32; 3]>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axes {
    /// Origin of the axes: the world's origin, or the centre of the scene box if the world's origin is far away.
    pub origin: Vec3,
    /// Length of the axes, a round number of world units.
    pub length: f32,
}

impl Scene {
    /// Creates the scene with the requested cameras, and with the rays that the training step would draw. The samples
    /// of the rays are tested against the occupancy grid that training starts with. Fails if the requested split has no
    /// views, or if the requested camera does not exist.
    pub fn new(dataset: &Dataset, config: &Config, request: &Request<'_>) -> anyhow::Result<Self> {
        let Request { views, split, step, .. } = *request;
        if views.is_empty() {
            bail!("--split: expected a split with views, found none in `{split}`");
        }
        if let Some(found) = request.camera.filter(|&camera| camera >= views.len()) {
            let count = views.len();
            bail!("--camera: expected less than {count} (split `{split}`), found {found}");
        }
        config.check()?;
        let (mut bounds, found) = find_bounds(dataset, config, None)?;
        // Rays of an unbounded scene have no end: only their part around the cameras is drawn.
        if let Some(contraction) = &bounds.contraction {
            let shown = (SHOWN_RADII * contraction.radius()).max(2.0 * bounds.near);
            bounds.far = bounds.far.min(shown);
        }
        let chosen = request.camera.map_or(0..views.len(), |camera| camera..camera + 1);
        let drawer =
            Drawer { config, bounds, background: dataset.background, occupancy: found.as_ref(), step };

        let first = chosen.start;
        let shown = &views[chosen];
        let alone = request.camera.is_some();
        let (rays, facts) = drawer.draw(shown, 0, request.rays, !alone)?;
        let side = thumbnail::side_for(shown.len());
        let bins = usize::from(config.sampling.samples);
        let own = (OWN_SAMPLES / (shown.len() * bins)).max(4).min(request.rays);
        let camera = |(i, view): (usize, &View)| -> anyhow::Result<ShownCamera> {
            let own_rays = match alone {
                _ if request.rays == 0 => Vec::new(),
                true => Vec::new(),
                false => drawer.draw(&shown[i..=i], i, own, false)?.0,
            };
            let (name, thumbnail) = (view.name.clone(), Thumbnail::of(view, side, [1.0; 3]));
            let (index, camera, near) = (first + i, view.camera, bounds.near);
            Ok(ShownCamera { index, name, camera, near, thumbnail, own_rays, colour: None })
        };
        let cameras = shown.iter().enumerate().map(camera).collect::<Result<Vec<_>, _>>()?;
        // Marched rays have samples in the whole scene box, also outside of near and far.
        for t in
            rays.iter().chain(cameras.iter().flat_map(|camera| &camera.own_rays)).flat_map(ShownRay::samples)
        {
            (bounds.near, bounds.far) = (bounds.near.min(t), bounds.far.max(t));
        }
        let frustum = request.frustum.unwrap_or_else(|| frustum_length(&cameras, &bounds));
        let up = request.up.unwrap_or_else(|| nearest_axis(views));
        let axes = Axes::of(&cameras, &bounds);
        let name = dataset.name.clone();
        let findings = None;
        Ok(Self { name, split, cameras, rays, alone, step: facts, bounds, up, frustum, axes, findings })
    }

    /// Returns the outline of the scene box or, in an unbounded scene, of the inner ball: polylines, world units.
    pub fn outline(&self) -> Vec<Vec<Vec3>> {
        const EDGE: usize = 8;
        const CIRCLE: usize = 64;
        let Some(contraction) = &self.bounds.contraction else {
            let ends = [self.bounds.scene_box.min, self.bounds.scene_box.max];
            let corner = |i: usize| Vec3::new(ends[i & 1].x, ends[i >> 1 & 1].y, ends[i >> 2].z);
            let edges = (0..8).flat_map(|i| [1, 2, 4].map(|axis| (i, i | axis))).filter(|(a, b)| a != b);
            let pieces = |(a, b)| {
                let at = |k| corner(a).lerp(corner(b), k as f32 / EDGE as f32);
                (0..=EDGE).map(at).collect()
            };
            return edges.map(pieces).collect();
        };
        let (side, ahead) = self.up.any_orthonormal_pair();
        let circle = |(x, y): (Vec3, Vec3)| {
            let at = |k: usize| {
                let (sin, cos) = (std::f32::consts::TAU * k as f32 / CIRCLE as f32).sin_cos();
                contraction.centre() + contraction.radius() * (x * cos + y * sin)
            };
            (0..=CIRCLE).map(at).collect()
        };
        [(side, ahead), (side, self.up), (ahead, self.up)].map(circle).to_vec()
    }

    pub fn centre(&self) -> Vec3 {
        0.5 * (self.bounds.scene_box.min + self.bounds.scene_box.max)
    }

    /// Returns the unit vector from the scene to a viewpoint with a side view of the cameras. `elevation`: degrees.
    pub fn towards_viewer(&self, elevation: f32) -> Vec3 {
        let (side, ahead) = self.up.any_orthonormal_pair();
        // Cameras inside an unbounded scene may look outward: behind is then opposite to the viewing direction.
        let behind = |camera: &ShownCamera| match self.bounds.contraction {
            Some(_) => -camera.camera.pose().forward(),
            None => camera.camera.pose().position - self.centre(),
        };
        let mean = self.cameras.iter().map(behind).sum::<Vec3>() / self.cameras.len() as f32;
        // A single camera is seen over its shoulder, several from the direction in which they overlap least.
        let turn = if self.alone { 40f32 } else { 55f32 };
        let azimuth = mean.dot(ahead).atan2(mean.dot(side)) + turn.to_radians();
        let elevation = elevation.to_radians();
        (side * azimuth.cos() + ahead * azimuth.sin()) * elevation.cos() + self.up * elevation.sin()
    }

    /// Returns the range of the colour map: smallest and largest distance `t` of all samples in occupied cells, world
    /// units; near and far of `self.bounds` if there are no two different values.
    pub fn colour_range(&self) -> (f32, f32) {
        let live = self.rays.iter().flat_map(|ray| &ray.live);
        let (low, high) =
            live.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), &t| (low.min(t), high.max(t)));
        if low < high { (low, high) } else { (self.bounds.near, self.bounds.far) }
    }

    pub fn live(&self) -> usize {
        self.rays.iter().map(|ray| ray.live.len()).sum()
    }

    pub fn culled(&self) -> usize {
        self.rays.iter().map(|ray| ray.culled.len()).sum()
    }

    pub fn title(&self) -> String {
        match self.cameras.as_slice() {
            [only] if self.alone => {
                format!("{}: {} camera {} alone ({})", self.name, self.split, only.index, only.name)
            }
            cameras => format!("{}: {} {} cameras", self.name, cameras.len(), self.split),
        }
    }

    /// Returns a sentence about the numbers of rays and samples, near, far, the scene's extent and the unit of length.
    pub fn facts(&self) -> String {
        let s = &self.step;
        let of = match self.alone {
            true => format!("{} rays that step {} draws where this camera is alone", self.rays.len(), s.step),
            false if self.split == "train" => {
                format!("{} of the {} rays of training step {}", self.rays.len(), s.rays, s.step)
            }
            // Training samples no views of this split, so the step is hypothetical.
            false => format!(
                "{} of the {} rays that step {} would draw from these views",
                self.rays.len(),
                s.rays,
                s.step
            ),
        };
        let culled = match s.occupancy {
            true => format!(", {} culled by the occupancy grid that training starts with", self.culled()),
            false => String::new(),
        };
        let (b, ends) = (&self.bounds, self.bounds.scene_box);
        let range = format!("from near {} to far {}", short(b.near), short(b.far));
        let range = match (s.marched, &b.contraction) {
            (_, Some(_)) => format!("at most {} steps a ray, {range} and on, which is not drawn", s.bins),
            (true, None) => format!("at most {} steps a ray, {range}", s.bins),
            (false, None) => format!("{} bins {range}", s.bins),
        };
        let place = match &b.contraction {
            Some(contraction) => format!(
                "unbounded, contracted outside of a ball of radius {} around {}",
                short(contraction.radius()),
                corner(contraction.centre())
            ),
            None => format!("scene box {} to {}", corner(ends.min), corner(ends.max)),
        };
        format!(
            "{of} (seed {}); {} live samples{culled}; {range}; {place}; lengths in world units",
            s.seed,
            self.live()
        )
    }

    pub fn ends(&self) -> &'static str {
        match self.bounds.contraction {
            Some(_) => "ball outside of which space is contracted",
            None => "scene box",
        }
    }
}

impl ShownCamera {
    /// Returns the corners of the picture at depth `z` along the view axis: world units, clockwise from top left.
    pub fn corners(&self, z: f32) -> [Vec3; 4] {
        let i = self.camera.intrinsics();
        let (w, h) = (i.width as f32, i.height as f32);
        [(0.0, 0.0), (w, 0.0), (w, h), (0.0, h)].map(|(x, y)| {
            let ray = self.camera.ray(x, y);
            // The limit keeps a corner beside or behind the camera (of a fisheye) at a finite distance.
            ray.at(z / self.camera.z_per_distance(&ray).max(0.1))
        })
    }
}

impl Axes {
    fn of(cameras: &[ShownCamera], bounds: &Bounds) -> Self {
        let b = bounds.scene_box;
        let centre = 0.5 * (b.min + b.max);
        // The box of an unbounded scene is four radii of the inner ball wide, so a quarter of a side is one radius.
        let share = if bounds.contraction.is_some() { 0.25 } else { 1.0 };
        let size = share * (b.max - b.min);
        let reach = cameras.iter().map(|c| c.camera.pose().position.distance(centre));
        let reach = reach.fold(size.length(), f32::max);
        let origin = if centre.length() <= reach { Vec3::ZERO } else { centre };
        Self { origin, length: round_length(0.6 * size.max_element()) }
    }

    /// Returns the length of the axes in words, for example "1 world unit long".
    pub fn length_in_words(&self) -> String {
        let plural = if self.length == 1.0 { "" } else { "s" };
        format!("{} world unit{plural} long", self.length)
    }

    /// Returns the end point of the drawn axis that begins at `origin` and has the direction `unit`; world coordinates.
    pub fn tip(&self, unit: Vec3) -> Vec3 {
        self.origin + self.length * unit
    }
}

/// Returns the frusta's depth, world units: small enough that they neither hide each other nor reach into the scene.
fn frustum_length(cameras: &[ShownCamera], bounds: &Bounds) -> f32 {
    let before_scene = 0.5 * if bounds.near > 0.0 { bounds.near } else { 0.25 * bounds.far };
    let positions: Vec<Vec3> = cameras.iter().map(|c| c.camera.pose().position).collect();
    let nearest = |(i, p): (usize, &Vec3)| {
        let others = positions.iter().enumerate().filter(|&(j, _)| j != i);
        others.map(|(_, other)| other.distance(*p)).min_by(f32::total_cmp)
    };
    let spacing = median(positions.iter().enumerate().filter_map(nearest)) as f32;
    let (least, most) = match &bounds.contraction {
        // The near plane of an unbounded scene says little about the distance of its surfaces.
        Some(contraction) => (FRUSTUM_RADII.0 * contraction.radius(), FRUSTUM_RADII.1 * contraction.radius()),
        None => (0.02 * before_scene, 0.8 * before_scene),
    };
    if spacing.is_nan() || spacing <= 0.0 {
        return most;
    }
    let i = cameras[0].camera.intrinsics();
    let width = (i.width as f32 / i.fx).max(i.height as f32 / i.fy);
    (0.7 * spacing / width).clamp(least, most)
}

/// Returns the world axis (±x, ±y, ±z) that is nearest to the mean of the cameras' up directions; +z if the mean is 0.
fn nearest_axis(views: &[View]) -> Vec3 {
    let mean: Vec3 = views.iter().map(|view| view.camera.pose().rotation.y_axis).sum();
    let axes = [Vec3::Z, Vec3::Y, Vec3::X, Vec3::NEG_Z, Vec3::NEG_Y, Vec3::NEG_X];
    // `max_by` returns the last of equal maxima. In reversed order, this is +Z if the mean is 0.
    axes.into_iter().rev().max_by(|a, b| a.dot(mean).total_cmp(&b.dot(mean))).unwrap_or(Vec3::Z)
}

/// Rounds `length` down to a number of the form 10^n, 2 · 10^n or 5 · 10^n.
fn round_length(length: f32) -> f32 {
    let magnitude = 10f32.powf(length.log10().floor());
    let fits = [5.0, 2.0, 1.0].into_iter().map(|factor| factor * magnitude).find(|&round| round <= length);
    fits.unwrap_or(length)
}

/// Formats a length with at most three decimals.
fn short(value: f32) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn corner(p: Vec3) -> String {
    format!("({}, {}, {})", short(p.x), short(p.y), short(p.z))
}

#[cfg(test)]
mod tests;
