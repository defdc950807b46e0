//! Replacement of the module `grid` in builds without the feature `grid`, which support no grid encoding.

use super::TableValues;
use crate::absent::absent;
use crate::simd::Isa;
use crate::space::SceneBox;
use core::marker::PhantomData;
use serde::{Deserialize, Serialize};

/// An uninhabited type, since builds without the feature `grid` support no grids. Opening a file with a grid fails with
/// [`BlobError::NotBuilt`](crate::blob::BlobError::NotBuilt).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum GridEncoding {}

impl GridEncoding {
    absent! {
        pub fn inputs(&self) -> u8;
        pub fn outputs(&self) -> usize;
        pub fn values(&self) -> usize;
        pub fn reads(&self) -> usize;
        pub(crate) fn fits(&self, &GridTables<'_>) -> bool;
        pub(crate) fn encode(&self, &GridTables<'_>, Isa, usize, &[f32], &mut [f32]) -> ();
        #[cfg(feature = "normals")]
        pub fn gradient(&self, &GridTables<'_>, Isa, usize, &[f32], &[f32], f32, &mut [f32]) -> ();
    }
}

/// The tables of a grid. In builds without the feature `grid`, [`GridTables::NONE`] is the type's only value.
#[derive(Clone, Copy, Debug)]
pub struct GridTables<'a>(PhantomData<&'a ()>);

impl<'a> GridTables<'a> {
    /// The tables of a network without a grid.
    pub const NONE: Self = Self(PhantomData);

    /// Returns [`GridTables::NONE`].
    pub fn new(_values: TableValues<'a>, _bounds: Option<&SceneBox>) -> Self {
        Self::NONE
    }
}
