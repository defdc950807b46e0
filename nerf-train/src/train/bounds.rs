//! Bounds of a scene, and its first occupancy grid.

use super::TrainError;
use crate::capture::sights::Sights;
use crate::data::cameras::bundle::median;
use crate::data::cameras::geometry::{begin, distances};
use crate::data::{Dataset, LookAt, View, frusta_box, scene_bounds};
use crate::model::config::Config;
use crate::train::occupancy::{Occupancy, free_cells};
use glam::{DVec3, Vec3};
use nerf_core::blob::SceneSampling;
use nerf_core::space::{BoundsError, Contraction, SceneBox};
use rayon::prelude::*;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    pub near: f32,
    pub far: f32,
    pub scene_box: SceneBox,
    pub contraction: Option<Contraction>,
    /// Distance from a camera, world units, within which the space of an unbounded scene is taken as empty.
    pub empty_before: f32,
}

impl Bounds {
    /// Returns the length of a ray march step, world units: the longest side of the scene box or, in an unbounded
    /// scene, the diameter of the uncontracted ball, divided by `steps_across`.
    pub fn step(&self, steps_across: u16) -> f32 {
        let across = match self.contraction {
            Some(contraction) => 2.0 * contraction.radius(),
            None => (self.scene_box.max - self.scene_box.min).max_element(),
        };
        across / f32::from(steps_across)
    }

    /// Returns the description, stored in the exported file, of a ray march in steps of [`Self::step`].
    pub fn sampling(&self, steps_across: u16) -> SceneSampling {
        match self.contraction {
            Some(contraction) => SceneSampling::Contracted {
                step: self.step(steps_across) / contraction.radius(),
                power: contraction.power(),
            },
            None => SceneSampling::March(self.step(steps_across)),
        }
    }
}

/// Number of cells along the longest side of a coarse visual hull. Only the scene box is computed from this hull.
const COARSE_HULL: u16 = 64;
/// Distance from a camera, in radii of the uncontracted ball, taken as empty in unbounded scenes without sparse points.
const NEAR_RADII: f32 = 0.1;
/// Far end of the rays of an unbounded scene without sparse points, in radii of the uncontracted ball.
const FAR_RADII: f32 = 100.0;
/// Least distance between two cameras, in radii of the uncontracted ball. In the first occupancy grid of an unbounded
/// scene, a cell is occupied only if two cameras at least this far apart see it.
const APART_RADII: f32 = 0.05;
/// Quantile and factor that bound the empty space before the cameras of an unbounded scene with sparse points. The
/// space ends at this quantile of the distances from the cameras to the points in their photographs, times the factor.
const ALL_VIEWS: (f32, f32) = (0.001, 0.6);
/// Quantile and factor that give the radius of the uncontracted ball if all cameras look nearly the same way. The
/// radius is this quantile of the distances from the cameras to the points in their photographs, times the factor.
const IN_FRONT: (f32, f32) = (0.01, 1.0);
/// Quantile and factor that give the far end of rays in an unbounded scene with sparse points. Rays end at this
/// quantile of the distances from the cameras to the points in their photographs, times the factor.
const BEHIND: (f32, f32) = (0.999, 2.0);

/// Finds near plane, far plane and scene box from settings and data. Fails if one of them is missing or invalid.
pub(crate) fn find_box(dataset: &Dataset, config: &Config) -> Result<Bounds, TrainError> {
    let (s, g) = (&config.sampling, &config.occupancy);
    if let Some(power) = s.contraction {
        return unbounded(dataset, config, power);
    }
    let proposed = scene_bounds(dataset);
    let missing = || TrainError::NoBounds { data: dataset.name.clone() };
    let near = s.near.or(proposed.map(|p| p.near)).ok_or_else(missing)?;
    let far = s.far.or(proposed.map(|p| p.far)).ok_or_else(missing)?;
    if !(near >= 0.0 && near < far && far.is_finite()) {
        return Err(BoundsError::Range { near, far }.into());
    }
    let given = match s.scene_box {
        Some([x0, y0, z0, x1, y1, z1]) => {
            // The settings state the box in the coordinates of the data set's files.
            let here =
                |corner: [f32; 3]| (Vec3::from(corner).as_dvec3() - DVec3::from(dataset.origin)).as_vec3();
            Some(SceneBox::new(here([x0, y0, z0]), here([x1, y1, z1]))?)
        }
        None => None,
    };
    let cameras: Vec<_> = dataset.cameras().copied().collect();
    let wide = match (given, proposed) {
        (Some(given), _) => given,
        // Without an occupancy grid no sample may be skipped: the box holds all that cameras see between near and far.
        _ if !g.skip => frusta_box(&cameras, near, far)?,
        (None, proposed) => proposed.ok_or_else(missing)?.scene_box,
    };
    let tight = || hull(dataset, config, wide, COARSE_HULL).and_then(|coarse| coarse.tight_box());
    let scene_box = if given.is_some() { wide } else { tight().unwrap_or(wide) };
    Ok(Bounds { near, far, scene_box, contraction: None, empty_before: near })
}

/// Returns the bounds of an unbounded scene. `power`: power of the contraction. The uncontracted ball is centred on the
/// point that the cameras look at or, if all look in nearly the same direction, on the mean of their positions.
fn unbounded(dataset: &Dataset, config: &Config, power: u8) -> Result<Bounds, TrainError> {
    let s = &config.sampling;
    let cameras: Vec<_> = dataset.train.iter().map(|view| view.camera).collect();
    let missing = || TrainError::NoBounds { data: dataset.name.clone() };
    // Cameras with parallel axes look at no common point.
    let look_at = LookAt::of(&cameras);
    let same_way = look_at.is_none_or(|look_at| look_at.forward_facing());
    let of_view = |view: &View| distances(view, &dataset.points);
    let seen = dataset.train.par_iter().map(of_view).collect::<Vec<_>>().concat();
    let nothing_before = s.near.or(dataset.near).or_else(|| begin(seen.clone(), ALL_VIEWS));
    let in_front = begin(seen.clone(), IN_FRONT).or(nothing_before).filter(|_| same_way);
    let eyes = || cameras.iter().map(|camera| camera.pose().position);
    let (centre, radius) = match in_front {
        Some(distance) => (eyes().sum::<Vec3>() / cameras.len() as f32, distance),
        None => {
            let centre = Vec3::from(look_at.ok_or_else(missing)?.point);
            (centre, median(eyes().map(|eye| (eye - centre).length())) as f32)
        }
    };
    let scene_box = Contraction::cube(centre, radius);
    let contraction = Contraction::new(&scene_box, power).ok_or_else(missing)?;
    // Rays begin at the camera, as in rendering; the field before the nearest visible point is empty.
    let near = s.near.unwrap_or(0.0);
    let far = s.far.or(dataset.far).or_else(|| begin(seen, BEHIND)).unwrap_or(FAR_RADII * radius);
    if !(near >= 0.0 && near < far && far.is_finite()) {
        return Err(BoundsError::Range { near, far }.into());
    }
    let empty_before = nothing_before.unwrap_or(NEAR_RADII * radius);
    Ok(Bounds { near, far, scene_box, contraction: Some(contraction), empty_before })
}

/// Returns the visual hull; `None` if the settings turn it off, or if the photographs do not show what is background.
fn hull(dataset: &Dataset, config: &Config, bounds: SceneBox, resolution: u16) -> Option<Occupancy> {
    let g = &config.occupancy;
    (g.skip && g.hull).then(|| Occupancy::carve(bounds, resolution, &dataset.train, dataset.background))?
}

/// Returns the bounds found by [`find_box`], and the first occupancy grid: `None` if the settings turn occupancy off.
pub(crate) fn find_bounds(
    dataset: &Dataset,
    config: &Config,
    sights: Option<&Sights>,
) -> Result<(Bounds, Option<Occupancy>), TrainError> {
    let bounds = find_box(dataset, config)?;
    let scene_box = bounds.scene_box;
    // For a learned grid, the hull is carved at half the resolution, in an eighth of the time; updates refine it.
    let resolution = config.occupancy_resolution(scene_box.max - scene_box.min);
    let carved = || match config.network.grid {
        Some(_) => hull(dataset, config, scene_box, resolution.div_ceil(2)).map(|hull| hull.halved()),
        None => hull(dataset, config, scene_box, resolution),
    };
    let full = || match &bounds.contraction {
        Some(contraction) => seen(dataset, config, &bounds, contraction, sights),
        None => Occupancy::full(scene_box, resolution),
    };
    let occupancy = config.occupancy.skip.then(|| carved().unwrap_or_else(full));
    Ok((bounds, occupancy))
}

/// Returns the first occupancy grid of an unbounded scene; see [`Occupancy::seen`].
fn seen(
    dataset: &Dataset,
    config: &Config,
    bounds: &Bounds,
    contraction: &Contraction,
    sights: Option<&Sights>,
) -> Occupancy {
    let (scene_box, views) = (bounds.scene_box, &dataset.train);
    let resolution = config.occupancy_resolution(scene_box.max - scene_box.min);
    let free = match sights.filter(|_| config.capture.free_space) {
        Some(sights) => {
            let sides = Occupancy::sides(scene_box.max - scene_box.min, resolution);
            free_cells(scene_box, sides, views, contraction, sights)
        }
        None => Vec::new(),
    };
    let near = |view: &View| match config.sampling.near {
        Some(near) => near,
        None => view.near.max(bounds.empty_before),
    };
    let nears: Vec<f32> = views.iter().map(near).collect();
    let apart = APART_RADII * contraction.radius();
    Occupancy::seen(scene_box, resolution, views, contraction, (&nears, apart), &free)
}
