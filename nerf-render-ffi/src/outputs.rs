//! What is asked for of each pixel, ray or point.

use crate::failure::Failure;
use nerf_core::plan::Outputs;

/// Colour is wanted.
pub const NERF_OUTPUT_RGB: u32 = 1;
/// Opacity is wanted.
pub const NERF_OUTPUT_OPACITY: u32 = 2;
/// Distance along the ray is wanted.
pub const NERF_OUTPUT_RAY_DISTANCE: u32 = 4;
/// Distance along the view axis is wanted.
pub const NERF_OUTPUT_Z_DEPTH: u32 = 8;
/// Distance along the ray at which half of the light is gone is wanted.
pub const NERF_OUTPUT_MEDIAN_DISTANCE: u32 = 16;
/// Normals are wanted.
pub const NERF_OUTPUT_NORMALS: u32 = 32;

pub(crate) fn read_outputs(name: &'static str, found: u32) -> Result<Outputs, Failure> {
    let all = NERF_OUTPUT_RGB
        | NERF_OUTPUT_OPACITY
        | NERF_OUTPUT_RAY_DISTANCE
        | NERF_OUTPUT_Z_DEPTH
        | NERF_OUTPUT_MEDIAN_DISTANCE
        | NERF_OUTPUT_NORMALS;
    if found & !all != 0 {
        return Err(Failure::Setting { name, expected: "NERF_OUTPUT_* or-ed", found });
    }
    Ok(Outputs {
        rgb: found & NERF_OUTPUT_RGB != 0,
        opacity: found & NERF_OUTPUT_OPACITY != 0,
        ray_distance: found & NERF_OUTPUT_RAY_DISTANCE != 0,
        z_depth: found & NERF_OUTPUT_Z_DEPTH != 0,
        median_distance: found & NERF_OUTPUT_MEDIAN_DISTANCE != 0,
        normals: found & NERF_OUTPUT_NORMALS != 0,
    })
}
