//! Replaces `contraction` in builds without the feature `contraction`: every scene is bounded.

use super::scene_box::SceneBox;
use crate::absent::absent;
use crate::camera::Ray;
use crate::simd::Lanes;
use glam::Vec3;

/// A type without values: this build has no contraction. Opening a file with a contraction fails with
/// [`BlobError::NotBuilt`](crate::blob::BlobError::NotBuilt).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Contraction {}

impl Contraction {
    /// Returns `None`: this build has no contraction.
    pub fn new(_: &SceneBox, _: u8) -> Option<Self> {
        None
    }

    absent! {
        pub fn centre(&self) -> Vec3;
        pub fn radius(&self) -> f32;
        pub fn power(&self) -> u8;
        pub fn contract(&self, Vec3) -> Vec3;
        pub fn contract_lanes<V: Lanes>(&self, [V; 3]) -> [V; 3];
        pub(crate) fn kept(&self, &Ray) -> [f32; 2];
        pub(crate) fn kept_lanes<V: Lanes>(&self, [V; 3]) -> [V; 3];
        #[cfg(feature = "normals")]
        pub(crate) fn gradient_in_world(&self, Vec3, Vec3) -> Vec3;
        pub fn centred(&self, &Ray) -> (Ray, f32);
        pub(crate) fn nearest<V: Lanes>(&self, [V; 3], [V; 3]) -> V;
        pub fn distance(&self, f32) -> f32;
        pub fn distance_lanes<V: Lanes>(&self, V) -> V;
        pub fn step_at<V: Lanes>(&self, V) -> V;
    }
}
