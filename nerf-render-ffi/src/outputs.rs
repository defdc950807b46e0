//! Flags that choose the outputs to compute for each pixel, ray or point.

use crate::failure::Failure;
use crate::render_options::at_most;
use nerf_core::plan::Outputs;

/// Flag that requests colour: `rgb` of `nerf_target` or `nerf_points`.
pub const NERF_OUTPUT_RGB: u32 = 1;
/// Flag that requests the opacity, 0 to 1: `opacity` of `nerf_target`.
pub const NERF_OUTPUT_OPACITY: u32 = 2;
/// Flag that requests the mean distance along the ray: `ray_distance` of `nerf_target`.
pub const NERF_OUTPUT_RAY_DISTANCE: u32 = 4;
/// Flag that requests the mean distance along the view axis: `z_depth` of `nerf_target`.
pub const NERF_OUTPUT_Z_DEPTH: u32 = 8;
/// Flag that requests the distance at which transmittance falls below one half: `median_distance` of `nerf_target`.
pub const NERF_OUTPUT_MEDIAN_DISTANCE: u32 = 16;
/// Flag that requests the normal of the surface: `normals` of `nerf_target`.
pub const NERF_OUTPUT_NORMALS: u32 = 32;

pub(crate) fn read_outputs(name: &'static str, found: u32) -> Result<Outputs, Failure> {
    // `NERF_OUTPUT_NORMALS` is the highest flag: a larger number has an unknown flag.
    at_most(name, "NERF_OUTPUT_* or-ed", found, 2 * NERF_OUTPUT_NORMALS - 1)?;
    let has = |output: u32| found & output != 0;
    Ok(Outputs {
        rgb: has(NERF_OUTPUT_RGB),
        opacity: has(NERF_OUTPUT_OPACITY),
        ray_distance: has(NERF_OUTPUT_RAY_DISTANCE),
        z_depth: has(NERF_OUTPUT_Z_DEPTH),
        median_distance: has(NERF_OUTPUT_MEDIAN_DISTANCE),
        normals: has(NERF_OUTPUT_NORMALS),
    })
}
