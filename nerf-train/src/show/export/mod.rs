//! A scene for other programs: a triangle mesh, a point cloud, a volume, in the data's coordinates and units.
//!
//! ```text
//! field ─► densities at a lattice ─► optical depths from outside ─► surface net ─► rays along normals ─► PLY, OBJ, GLB
//!      └─► volume: density and colour of every cell ─► NPZ
//! views ─► median distance along each ray ─► points ─► PLY
//! ```

mod field;
mod files;
mod lattice;
mod net;
mod optical_depth;
mod points;
mod surface;
mod volume;

pub use field::Field;
pub use files::{write_glb, write_obj, write_ply};
pub use lattice::Lattice;
pub use points::{points_of_surface, points_of_views};
pub use surface::{Surface, mesh};
pub use volume::{Volume, volume, write_npz};

use crate::system::summary::Short;
use glam::Vec3;
use nerf_core::space::SceneBox;
use serde::Serialize;
use std::path::Path;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Position relative to [`Mesh::origin`], world units.
    pub position: [f32; 3],
    /// Unit normal, outward.
    pub normal: [f32; 3],
    pub rgb: [f32; 3],
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Origin of the scene file's coordinates, as a point in the data set's world frame, world units.
    pub origin: [f64; 3],
    pub vertices: Vec<Vertex>,
    /// Vertex indices, counter-clockwise seen from outside; empty for a point cloud.
    pub triangles: Vec<[u32; 3]>,
}

#[derive(Debug, Default, Serialize)]
pub struct Summary {
    pub file: String,
    #[serde(rename = "as")]
    pub kind: &'static str,
    pub file_bytes: u64,
    pub box_min_world_units: [f64; 3],
    pub box_max_world_units: [f64; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cell_world_units: Option<Short>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threshold_per_world_unit: Option<Short>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cells: Option<[usize; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vertices: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub triangles: Option<usize>,
    pub total_seconds: f64,
}

impl Summary {
    /// Creates a summary with only file, kind and box; the caller sets all other fields. `origin` is added to `bounds`.
    pub fn new(file: &Path, kind: &'static str, bounds: &SceneBox, origin: [f64; 3]) -> Self {
        let world = |corner: Vec3| [0, 1, 2].map(|axis| f64::from(corner[axis]) + origin[axis]);
        Self {
            file: file.display().to_string(),
            kind,
            box_min_world_units: world(bounds.min),
            box_max_world_units: world(bounds.max),
            ..Self::default()
        }
    }
}

#[cfg(test)]
mod tests;
