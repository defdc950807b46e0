//! In the place of `contraction` where the feature is off: every scene has an end, and no code contracts.

use super::scene_box::SceneBox;
use crate::camera::Ray;
use crate::simd::Lanes;
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

    /// No value.
    pub fn centre(&self) -> Vec3 {
        match *self {}
    }

    /// No value.
    pub fn radius(&self) -> f32 {
        match *self {}
    }

    /// No value.
    pub fn power(&self) -> u8 {
        match *self {}
    }

    /// No value.
    pub fn contract(&self, _: Vec3) -> Vec3 {
        match *self {}
    }

    /// No value.
    pub fn contract_lanes<V: Lanes>(&self, _: [V; 3]) -> [V; 3] {
        match *self {}
    }

    pub(crate) fn keeps(&self, _: &Ray, _: f32, _: f32) -> bool {
        match *self {}
    }

    pub(crate) fn kept_lanes<V: Lanes>(&self, _: [V; 3]) -> [V; 3] {
        match *self {}
    }

    #[cfg(feature = "normals")]
    pub(crate) fn gradient_in_world(&self, _: Vec3, _: Vec3) -> Vec3 {
        match *self {}
    }

    /// No value.
    pub fn centred(&self, _: &Ray) -> (Ray, f32) {
        match *self {}
    }

    /// No value.
    pub fn distance(&self, _: f32) -> f32 {
        match *self {}
    }

    /// No value.
    pub fn distance_lanes<V: Lanes>(&self, _: V) -> V {
        match *self {}
    }

    /// No value.
    pub fn step_at(&self, _: f32) -> f32 {
        match *self {}
    }
}
