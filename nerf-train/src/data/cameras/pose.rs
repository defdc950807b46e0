//! What poses and angles of files get wrong.

use std::f64::consts::PI;

/// What a 4×4 matrix must end with.
pub(crate) const BOTTOM_ROW: &str = "a bottom row of 0 0 0 1";

/// How far it may be off: numbers are written with few digits.
const ROUNDING: f64 = 1e-6;

/// The bottom row of a matrix of four rows of four, in words, if it is not 0 0 0 1.
///
/// Another row is a projective map or a transposed matrix, of which the three rows above are no pose; dropping it would
/// read a wrong one without a word.
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

/// An angle of view in words, if it is none in radians.
pub(crate) fn angle_fault(angle: f64) -> Option<String> {
    if angle > 0.0 && angle < PI {
        None
    } else if (PI..180.0).contains(&angle) {
        Some(format!("{angle}: looks like degrees, which would be {:.4}", angle.to_radians()))
    } else {
        Some(angle.to_string())
    }
}
