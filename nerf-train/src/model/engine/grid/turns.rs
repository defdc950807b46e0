//! Which levels of the tables move at a step.
//!
//! Adam costs as much for a small gradient as for a large one, and a hashed level has most of a grid's entries: they move
//! in turns, each at every `hashed_every`th step by the sum of its gradients, which Adam takes as it takes a mean. Dense
//! levels move at every step.

use crate::model::engine::Adam;
use nerf_core::encoding::GridLevel;

/// How many times a level has moved, counted from 1, if it moves at step `step`, counted from 1.
pub(super) fn moves(adam: &Adam, level: &GridLevel, step: u64) -> Option<u64> {
    if level.mask.is_none() {
        return Some(step);
    }
    let (every, first) = (u64::from(adam.hashed_every), level.index as u64);
    let at = step + first;
    at.is_multiple_of(every).then_some(at / every - first / every)
}

/// Entries of a level whose gradient is summed over steps.
pub(super) fn waiting_entries(adam: &Adam, level: &GridLevel) -> usize {
    if adam.hashed_every > 1 && level.mask.is_some() { level.entries } else { 0 }
}
