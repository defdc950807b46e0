//! Cuts a batch into chunks of whole rays; the cuts depend on the batch only.

use super::{Batch, BatchRay};
use std::ops::Range;

/// Most samples of a chunk, except for its last ray: their activations fit the caches.
pub(super) const SAMPLES: usize = 512;
/// Most rays of a chunk: rays without samples cost time, too.
const RAYS: usize = 2048;

/// A part of a batch that goes through the network together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Chunk {
    Rays { rays: Range<usize>, samples: Range<usize> },
    Empty(Range<usize>),
}

/// Fills `chunks` with the parts of the batch, in order, of up to `most` samples, except for a longer ray: an even
/// number of chunks of about the same size, so that two threads finish at the same time.
pub(super) fn cut(batch: &Batch, most: usize, chunks: &mut Vec<Chunk>) {
    chunks.clear();
    let total = batch.positions.len();
    let share = total.div_ceil(total.div_ceil(most).next_multiple_of(2).max(1));
    let (mut rays, mut samples) = (0..0, 0..0);
    for BatchRay { samples: more, .. } in &batch.rays {
        let full = samples.len() >= share.max(1) || rays.len() == RAYS;
        if full && !rays.is_empty() {
            chunks.push(Chunk::Rays { rays: rays.clone(), samples: samples.clone() });
            (rays, samples) = (rays.end..rays.end, samples.end..samples.end);
        }
        rays.end += 1;
        samples.end += *more as usize;
    }
    if !rays.is_empty() {
        chunks.push(Chunk::Rays { rays, samples });
    }
    let points = batch.empty.len();
    chunks.extend((0..points).step_by(most).map(|i| Chunk::Empty(i..points.min(i + most))));
}
