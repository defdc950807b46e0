//! 3D view of one training step: cameras with frusta and pictures, rays and their samples.
//!
//! The code that fills training batches also chooses the rays and samples of a [`Scene`], which a [`page`] shows.

mod findings;
pub mod page;
pub mod sampling;
pub mod scene;

use crate::system::summary::Short;
pub use findings::checked;
use glam::Vec3;
pub use scene::{Request, Scene};
use serde::Serialize;

#[derive(Debug, Serialize)]
pub struct Summary<'s> {
    pub data: &'s str,
    pub split: &'s str,
    pub cameras: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view: Option<&'s str>,
    pub step: u64,
    pub seed: u64,
    pub bins_per_ray: u64,
    pub rays_shown: usize,
    pub live_samples_shown: usize,
    pub culled_samples_shown: usize,
    pub rays_in_step: usize,
    pub live_samples_in_step: usize,
    pub near_world_units: Short,
    pub far_world_units: Short,
    pub box_min_world_units: [f64; 3],
    pub box_max_world_units: [f64; 3],
    pub frustum_world_units: Short,
    pub up: [f64; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ball_centre_world_units: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ball_radius_world_units: Option<Short>,
}

impl<'s> Summary<'s> {
    pub fn of(scene: &'s Scene) -> Self {
        let numbers = |p: Vec3| p.to_array().map(f64::from);
        let (s, b) = (&scene.step, &scene.bounds);
        let only = scene.cameras.first().filter(|_| scene.alone);
        Self {
            data: &scene.name,
            split: scene.split,
            cameras: scene.cameras.len(),
            camera: only.map(|only| only.index),
            view: only.map(|only| only.name.as_str()),
            step: s.step.into(),
            seed: s.seed,
            bins_per_ray: s.bins.into(),
            rays_shown: scene.rays.len(),
            live_samples_shown: scene.live(),
            culled_samples_shown: scene.culled(),
            rays_in_step: s.rays,
            live_samples_in_step: s.live,
            near_world_units: Short(b.near),
            far_world_units: Short(b.far),
            box_min_world_units: numbers(b.scene_box.min),
            box_max_world_units: numbers(b.scene_box.max),
            frustum_world_units: Short(scene.frustum),
            up: numbers(scene.up),
            ball_centre_world_units: b.contraction.as_ref().map(|contraction| numbers(contraction.centre())),
            ball_radius_world_units: b.contraction.as_ref().map(|contraction| Short(contraction.radius())),
        }
    }
}
