//! Normals of the rays in flight: gradients of the samples that count, in blocks of their own.

use crate::memory::{Layout, at, column, head, put, put_column};
use crate::network::{GradientScratch, Network, Scratch};
use crate::plan::Plan;
use crate::render::frame::{Frame, block_samples, columns_of};
use crate::volume::NormalSum;
use glam::Vec3;

#[cfg(test)]
mod tests;

/// The rays' normals, and the samples queued for their gradient; all empty where normals are not requested.
pub(in crate::render) struct Normals<'w> {
    /// `[rays]`.
    sums: &'w mut [NormalSum],
    queue: Queue<'w>,
    memory: GradientScratch<'w>,
    /// ∂raw_sigma/∂x of a block, `[3][samples]`.
    gradient: &'w mut [f32],
}

/// Picks of any number of blocks: `[samples]` each. Where a sample is follows from its ray.
struct Queue<'w> {
    owner: &'w mut [u32],
    t: &'w mut [f32],
    weight: &'w mut [f32],
    count: usize,
}

impl<'w> Normals<'w> {
    pub fn lay_out(layout: &mut impl Layout<'w>, network: &Network<'_>, plan: &Plan<'_>) -> Self {
        let (rays, samples) =
            if plan.outputs.normals { (plan.batch.rays, block_samples(network, plan)) } else { (0, 0) };
        Self {
            sums: layout.slice(rays, NormalSum::NONE),
            queue: Queue {
                owner: layout.slice(samples, 0),
                t: layout.slice(samples, 0.0),
                weight: layout.slice(samples, 0.0),
                count: 0,
            },
            memory: GradientScratch {
                signs: layout.slice(network.sign_words(samples), 0),
                encoded: layout.slice(network.gradient_rows() * samples, 0.0),
            },
            gradient: layout.slice(3 * samples, 0.0),
        }
    }

    /// A new ray in place `ray`.
    pub fn begin(&mut self, ray: usize) {
        if let Some(sum) = self.sums.get_mut(ray) {
            *sum = NormalSum::NONE;
        }
    }

    /// The pixel's normal; `ray` is `None` where nothing was met.
    pub fn finish(&self, ray: Option<usize>, opacity: f32) -> [f32; 3] {
        ray.and_then(|ray| self.sums.get(ray)).map_or([0.0; 3], |sum| sum.finish(opacity))
    }
}

impl Frame<'_, '_> {
    /// Lets the block's picks wait for their normals, which are worked out whenever a block of them waits.
    pub(in crate::render) fn queue_normals(&mut self, picked: usize) {
        if !self.plan.outputs.normals {
            return;
        }
        for i in 0..picked {
            let queue = &mut self.normals.queue;
            put(queue.owner, queue.count, at(self.picks.owner, i));
            put(queue.t, queue.count, at(self.block.t, at(self.picks.column, i) as usize));
            put(queue.weight, queue.count, at(self.picks.weight, i));
            queue.count += 1;
            if queue.count == queue.owner.len() {
                self.flush_normals();
            }
        }
    }

    /// Works out the normals of the samples that wait; what the block at work left in the scratch is lost.
    pub(in crate::render) fn flush_normals(&mut self) {
        let Normals { sums, queue, memory, gradient } = &mut self.normals;
        let n = core::mem::take(&mut queue.count);
        if n == 0 {
            return;
        }
        let stride = columns_of(self.network, n);
        for column in 0..stride {
            // What only fills the block up is a copy of its last sample.
            let from = column.min(n - 1);
            let p = self.plan.point(&at(self.rays, at(queue.owner, from) as usize).ray, at(queue.t, from));
            put_column(self.positions, stride, column, p.to_array());
        }
        let mut scratch = Scratch {
            stride,
            encoded: &mut *self.scratch.encoded,
            front: &mut *self.scratch.front,
            back: &mut *self.scratch.back,
        };
        let blur = self.plan.normal_deviation();
        self.network.gradient(self.plan.math, &mut scratch, memory, self.positions, blur, gradient);
        self.counters.add_normals(self.network, n);
        for (i, (&owner, &weight)) in head(queue.owner, n).iter().zip(&*queue.weight).enumerate() {
            let gradient = Vec3::from(column(gradient, stride, i));
            let gradient = match &self.plan.contraction {
                Some(contraction) => {
                    let p: [f32; 3] = column(self.positions, stride, i);
                    contraction.gradient_in_world(p.into(), gradient)
                }
                None => gradient,
            };
            self.counters.invalid_samples += u64::from(!gradient.is_finite());
            if let Some(sum) = sums.get_mut(owner as usize) {
                sum.add(weight, gradient);
            }
        }
    }
}
