//! Poses and angles of view as files state them, and descriptions of invalid ones.

use glam::DVec3;
use nerf_core::camera::Pose;
use std::f64::consts::PI;

/// Makes a pose from the upper three rows of a camera-to-world matrix, with its position relative to `origin`.
pub(crate) fn pose_of(mut rows: [[f64; 4]; 3], origin: DVec3) -> Pose {
    rows.iter_mut().zip(origin.to_array()).for_each(|(row, origin)| row[3] -= origin);
    Pose::from_rows(rows.map(|row| row.map(|v| v as f32)))
}

pub(crate) const BOTTOM_ROW: &str = "a bottom row of 0 0 0 1";

/// Tolerance when the bottom row of a matrix is compared with 0 0 0 1: files write numbers with few digits.
const ROUNDING: f64 = 1e-6;

/// Describes the bottom row of a 4×4 matrix if the row is wrong; returns `None` if the row is 0 0 0 1. A matrix with a
/// wrong bottom row is projective or transposed: its first three rows are no pose.
pub(crate) fn bottom_row_fault(matrix: &[impl AsRef<[f64]>]) -> Option<String> {
    let [a, b, c, bottom] = matrix else { return None };
    let near = |row: &[f64], expected: &[f64]| {
        row.len() == expected.len() && row.iter().zip(expected).all(|(x, y)| (x - y).abs() <= ROUNDING)
    };
    let bottom = bottom.as_ref();
    if near(bottom, &[0.0, 0.0, 0.0, 1.0]) {
        return None;
    }
    let last = [a, b, c].map(|row| row.as_ref().last().copied().unwrap_or(f64::NAN));
    let transposed = near(&last, &[0.0; 3]) && near(&bottom[3.min(bottom.len())..], &[1.0]);
    let row = bottom.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    Some(if transposed { format!("{row}: the matrix looks transposed") } else { row })
}

/// Describes `angle`, radians, if it is not an angle of view between 0 and π, else returns `None`.
pub(crate) fn angle_fault(angle: f64) -> Option<String> {
    if angle > 0.0 && angle < PI {
        None
    } else if (PI..180.0).contains(&angle) {
        Some(format!("{angle}: looks like degrees, which would be {:.4}", angle.to_radians()))
    } else {
        Some(angle.to_string())
    }
}
