//! Which pixels are drawn at all.

use crate::data::{Background, View};
use crate::train::occupancy::is_foreground;
use rayon::prelude::*;

/// How far around the foreground rays are still drawn, pixels.
const FOREGROUND_MARGIN: usize = 4;

/// Pixels within [`FOREGROUND_MARGIN`] of something, in the numbering over all views.
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

/// Pixels that count, in the numbering over all views; `None` where all do. At least one of each view does, and there
/// are at most 2^32 where some do not (`dataset`).
pub(super) fn counting(views: &[View], starts: &[u64]) -> Option<Vec<u32>> {
    views.iter().any(|view| view.mask.is_some()).then_some(())?;
    let of_view = |(view, &start): (&View, &u64)| {
        let kept = (0..view.pixels.len()).filter(|&i| view.counts(i));
        kept.map(|i| (start + i as u64) as u32).collect::<Vec<_>>()
    };
    Some(views.iter().zip(starts).flat_map(of_view).collect())
}
