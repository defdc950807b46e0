//! In the place of `contraction.rs` where the feature is off: every scene has an end, and no code contracts.

use crate::math::lanes::Lanes;
use crate::ray::{Ray, SceneBox};
use glam::Vec3;

/// No value: this build has no contraction. Opening a file with one is
/// [`BlobError::NotBuilt`](crate::blob::BlobError::NotBuilt).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Contraction {}

impl Contraction {
    /// `None`.
    pub fn new(_: &SceneBox, _: u8) -> Option<Self> {
        None
    }

    pub(crate) fn centre(&self) -> Vec3 {
        match *self {}
    }

    pub(crate) fn radius(&self) -> f32 {
        match *self {}
    }

    pub(crate) fn contract(&self, _: Vec3) -> Vec3 {
        match *self {}
    }

    pub(crate) fn contract_lanes<V: Lanes>(&self, _: [V; 3]) -> [V; 3] {
        match *self {}
    }

    #[cfg(feature = "normals")]
    pub(crate) fn gradient_in_world(&self, _: Vec3, _: Vec3) -> Vec3 {
        match *self {}
    }

    pub(crate) fn centred(&self, _: &Ray) -> (Ray, f32) {
        match *self {}
    }

    pub(crate) fn distance(&self, _: f32) -> f32 {
        match *self {}
    }

    pub(crate) fn distance_lanes<V: Lanes>(&self, _: V) -> V {
        match *self {}
    }

    pub(crate) fn step_at(&self, _: f32) -> f32 {
        match *self {}
    }
}
