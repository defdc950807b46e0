//! Lines of pixels, along which the smoothness loss compares disparities.

use crate::model::engine::LINE;
use std::ops::Range;

/// One in this number of rays of an unbounded scene lies on a line.
const LINE_SHARE: usize = 8;
/// Longer side of a photograph, in multiples of the smallest spacing of a line's pixels.
const SPACINGS: usize = 60;

/// Indices of the rays on lines in a batch of `rays` rays whose first `before` rays do not lie on lines.
pub(super) fn rays_on_lines(before: usize, rays: usize) -> Range<usize> {
    let first = before.next_multiple_of(LINE);
    first..first + rays / LINE_SHARE / LINE * LINE
}

/// Returns row-major indices of equally spaced pixels on a row or column through `pixel`. Their spacing is a sixtieth of the
/// longer side, or two, four or eight times as much; 3 random bits of `bits` decide. `None`: the photograph is too small.
pub(super) fn pixels_on_line((width, height): (u32, u32), pixel: usize, bits: u32) -> Option<[usize; LINE]> {
    let (width, height) = (width as usize, height as usize);
    let spacing = (width.max(height) / SPACINGS).max(1) << (bits & 3);
    let (side, at, stride) =
        if bits & 4 == 0 { (width, pixel % width, 1) } else { (height, pixel / width, width) };
    let last = side.checked_sub(1 + (LINE - 1) * spacing)?;
    let first = pixel - (at - at.min(last)) * stride;
    Some(std::array::from_fn(|k| first + k * spacing * stride))
}
