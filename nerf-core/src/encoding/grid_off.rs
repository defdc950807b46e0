//! Replaces `grid` in builds without that feature: there is no grid and no code that encodes by one.

use super::TableValues;
use crate::absent::absent;
use crate::simd::Isa;
use crate::space::SceneBox;
use core::marker::PhantomData;
use serde::{Deserialize, Serialize};

/// A type without values: this build has no grids. Opening a file with a grid is
/// [`BlobError::NotBuilt`](crate::blob::BlobError::NotBuilt).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum GridEncoding {}

impl GridEncoding {
    absent! {
        pub fn inputs(&self) -> u8;
        pub fn outputs(&self) -> usize;
        pub fn values(&self) -> usize;
        pub fn reads(&self) -> usize;
    }
}

/// The tables of a grid, always absent: this build has no grids.
#[derive(Clone, Copy, Debug)]
pub struct GridTables<'a>(PhantomData<&'a ()>);

impl<'a> GridTables<'a> {
    /// The tables of a network without a grid.
    pub const NONE: Self = Self(PhantomData);

    /// Returns [`GridTables::NONE`].
    pub fn new(_values: TableValues<'a>, _bounds: Option<&SceneBox>) -> Self {
        Self::NONE
    }

    /// Whether the tables fit `grid`, which cannot exist.
    pub(crate) fn fit(&self, grid: &GridEncoding) -> bool {
        match *grid {}
    }

    pub(crate) fn encode(&self, _: Isa, grid: &GridEncoding, _stride: usize, _x: &[f32], _out: &mut [f32]) {
        match *grid {}
    }

    #[cfg(feature = "normals")]
    pub(crate) fn gradient(
        &self,
        _: Isa,
        grid: &GridEncoding,
        _stride: usize,
        _x: &[f32],
        _of_encoded: &[f32],
        _blur: f32,
        _of_x: &mut [f32],
    ) {
        match *grid {}
    }
}
