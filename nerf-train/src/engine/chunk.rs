//! Cuts a batch into chunks of whole rays, in a way that only the batch decides.

use super::{Batch, BatchRay};
use std::ops::Range;

/// Samples a chunk is filled up to; a longer ray is a chunk of its own.
pub(super) const SAMPLES: usize = 512;
/// Most rays of a chunk: rays without samples have a price too.
const RAYS: usize = 2048;

/// A part of a batch that goes through the network together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Chunk {
    /// Whole rays and their samples.
    Rays { rays: Range<usize>, samples: Range<usize> },
    /// Points of culled space.
    Empty(Range<usize>),
}

/// Fills `chunks` with the batch's, in order.
pub(super) fn cut(batch: &Batch, chunks: &mut Vec<Chunk>) {
    chunks.clear();
    let (mut rays, mut samples) = (0..0, 0..0);
    for BatchRay { samples: more, .. } in &batch.rays {
        let more = *more as usize;
        let full = samples.len() + more > SAMPLES || rays.len() == RAYS;
        if full && !rays.is_empty() {
            chunks.push(Chunk::Rays { rays: rays.clone(), samples: samples.clone() });
            (rays, samples) = (rays.end..rays.end, samples.end..samples.end);
        }
        rays.end += 1;
        samples.end += more;
    }
    if !rays.is_empty() {
        chunks.push(Chunk::Rays { rays, samples });
    }
    let points = batch.empty.len();
    chunks.extend((0..points).step_by(SAMPLES).map(|i| Chunk::Empty(i..points.min(i + SAMPLES))));
}
