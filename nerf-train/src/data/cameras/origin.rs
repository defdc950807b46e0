//! Shifts the origin of data sets whose cameras are too far from the origin for f32, as in GPS coordinates.

use glam::DVec3;

/// Maximum distance between the origin and the middle of the cameras' bounding box, in units of half the box's longest
/// side. Beyond this distance, the origin is moved. At the maximum, f32 rounds positions to 4e-6 of the half side,
/// about a hundredth of a pixel.
const FAR_AWAY: f64 = 64.0;

/// Start of the suffix that states a moved origin's coordinates in a data set's name.
pub(crate) const STATED: &str = ", origin at (";

/// Chooses an origin, in the file's world: a point near the middle of the cameras if the middle is too far from the
/// file's origin, else (0, 0, 0). Coordinates are multiples of a power of ten, so that few decimals state them exactly.
pub(crate) fn origin(cameras: impl IntoIterator<Item = [f64; 3]>) -> DVec3 {
    let cameras: Vec<DVec3> =
        cameras.into_iter().map(DVec3::from).filter(|camera| camera.is_finite()).collect();
    let low = cameras.iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let high = cameras.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    let (middle, reach) = (0.5 * low + 0.5 * high, 0.5 * (high - low).max_element());
    if !(reach > 0.0 && middle.length() > FAR_AWAY * reach) {
        return DVec3::ZERO;
    }
    // Only powers of ten from 1 on are exact in f64. For a smaller unit, its inverse is used.
    let exponent = reach.log10().ceil();
    let rounded = match 10f64.powf(exponent.abs()) {
        unit if exponent >= 0.0 => (middle / unit).round() * unit,
        parts => (middle * parts).round() / parts,
    };
    if rounded.is_finite() { rounded } else { DVec3::ZERO }
}

/// Reads the origin from `name`, the data set's name in a `.nerf` blob; (0, 0, 0) if the name states none.
pub fn origin_in_name(name: &str) -> [f64; 3] {
    let stated = || {
        let numbers = name.rsplit_once(STATED)?.1.strip_suffix(')')?;
        let numbers: Option<Vec<f64>> = numbers.split(", ").map(|number| number.parse().ok()).collect();
        let origin: [f64; 3] = numbers?.try_into().ok()?;
        origin.iter().all(|v| v.is_finite()).then_some(origin)
    };
    stated().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::Dataset;

    #[test]
    fn a_name_gives_its_origin_back() {
        let named = |name: &str| Dataset { name: name.into(), ..crate::data::demo::small(1, 0, 4) };
        for origin in [[0.0; 3], [1e6, -2e6, 0.125], [123456.7, 0.1 + 0.2, -4e300]] {
            for name in ["fox", "a, origin at (1, 2, 3)"] {
                let moved = named(name).counted_from(origin.into());
                let expected = if origin == [0.0; 3] { origin_in_name(name) } else { origin };
                assert_eq!(origin_in_name(&moved.name), expected, "{}", moved.name);
            }
        }
        for name in ["", "fox", "x, origin at (", "x, origin at (1, 2)", "x, origin at (1, 2, inf)"] {
            assert_eq!(origin_in_name(name), [0.0; 3], "{name}");
        }
    }

    #[test]
    fn only_worlds_far_from_their_origin_are_moved() {
        let around = |middle: [f64; 3], reach: f64| {
            [[reach, 0.0, 0.0], [-reach, 0.0, 0.3 * reach]]
                .map(|p| (DVec3::from(p) + DVec3::from(middle)).into())
        };
        for (middle, reach) in [([0.0; 3], 1e-3), ([60.0, 0.0, 0.0], 1.0), ([0.0, 6e4, 0.0], 1e3)] {
            assert_eq!(origin(around(middle, reach)), DVec3::ZERO, "{middle:?} {reach}");
        }
        assert_eq!(origin(around([1e6, -2e6, 3.0], 2.0)), DVec3::new(1e6, -2e6, 0.0));
        assert_eq!(origin(around([123456.7, 0.0, 0.0], 0.02)), DVec3::new(123456.7, 0.0, 0.0));
        assert_eq!(origin([[1e6; 3]]), DVec3::ZERO, "one camera has no size");
        assert_eq!(origin([]), DVec3::ZERO);
    }
}
