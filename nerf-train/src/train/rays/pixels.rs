//! Pixels from which batches are drawn, and lines of pixels, along which the smoothness loss compares disparities.

use crate::data::{Background, View};
use crate::model::engine::LINE;
use crate::train::occupancy::is_foreground;
use rayon::prelude::*;
use std::ops::Range;

/// Number of rays of a batch per ray through a line of pixels, in an unbounded scene.
const LINE_SHARE: usize = 8;
/// Divisor of a photograph's longer side. The quotient is the smallest spacing of the pixels of a line, pixels.
const SPACINGS: usize = 60;

/// Returns the indices of a batch's rays on lines of pixels: one eighth of the `rays` rays, after `before` rays.
pub(super) fn rays_on_lines(before: usize, rays: usize) -> Range<usize> {
    let first = before.next_multiple_of(LINE);
    first..first + rays / LINE_SHARE / LINE * LINE
}

/// Returns the row-major indices of equally spaced pixels on the row or column of `pixel`. The spacing is 1, 2, 4 or 8
/// sixtieths of the photograph's longer side. Three bits of `bits` choose row or column, and spacing. `None` if the
/// photograph is too small.
pub(super) fn pixels_on_line((width, height): (u32, u32), pixel: usize, bits: u32) -> Option<[usize; LINE]> {
    let (width, height) = (width as usize, height as usize);
    let spacing = (width.max(height) / SPACINGS).max(1) << (bits & 3);
    let (side, at, stride) =
        if bits & 4 == 0 { (width, pixel % width, 1) } else { (height, pixel / width, width) };
    let last = side.checked_sub(1 + (LINE - 1) * spacing)?;
    let first = pixel - (at - at.min(last)) * stride;
    Some(std::array::from_fn(|k| first + k * spacing * stride))
}

/// Margin around the foreground, pixels. Only pixels of the foreground and this margin are drawn for batches.
const FOREGROUND_MARGIN: usize = 4;

/// Returns the unmasked pixels within [`FOREGROUND_MARGIN`] of foreground, as indices among the pixels of all views.
/// `None` for an unknown background. `starts`: index of each view's first pixel.
pub(super) fn near_foreground(views: &[View], starts: &[u64], background: Background) -> Option<Vec<u32>> {
    let of_view = |(view, &start): (&View, &u64)| -> Option<Vec<u32>> {
        let (width, height) = view.size();
        let (width, height) = (width as usize, height as usize);
        let mut mask = Vec::with_capacity(view.pixels.len());
        for &pixel in &view.pixels {
            mask.push(is_foreground(pixel, background)?);
        }
        if let Some(kept) = &view.mask {
            mask.iter_mut().zip(kept).for_each(|(mask, kept)| *mask &= kept);
        }
        let spread = |mask: &[bool], stride: usize, length: usize, at: usize, line: usize| {
            let from = at.saturating_sub(FOREGROUND_MARGIN);
            (from..(at + FOREGROUND_MARGIN + 1).min(length)).any(|i| mask[line + i * stride])
        };
        let rows: Vec<bool> =
            (0..mask.len()).map(|i| spread(&mask, 1, width, i % width, i / width * width)).collect();
        let near = |i: &usize| spread(&rows, width, height, i / width, i % width) && view.counts(*i);
        let near = (0..mask.len()).filter(near);
        Some(near.map(|i| (start + i as u64) as u32).collect())
    };
    let parts: Option<Vec<Vec<u32>>> = views.par_iter().zip(starts).map(of_view).collect();
    Some(parts?.concat())
}

/// Returns the indices of the unmasked pixels, counted over the pixels of all views; `None` if no view has a mask. The
/// data set guarantees that each view has an unmasked pixel and that, with masks, there are at most 2^32 pixels.
pub(super) fn counting(views: &[View], starts: &[u64]) -> Option<Vec<u32>> {
    views.iter().any(|view| view.mask.is_some()).then_some(())?;
    let of_view = |(view, &start): (&View, &u64)| {
        let kept = (0..view.pixels.len()).filter(|&i| view.counts(i));
        kept.map(|i| (start + i as u64) as u32).collect::<Vec<_>>()
    };
    Some(views.iter().zip(starts).flat_map(of_view).collect())
}
