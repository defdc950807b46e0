//! Normals of the rays in flight: gradients of the samples that count, in blocks of their own.

use crate::kernels::{Arena, at, column, head, lines_for, put, put_column};
use crate::network::{GradientScratch, Network, Scratch};
use crate::plan::Plan;
use crate::render::frame::{Frame, block_samples, columns_of};
use crate::volume::NormalSum;
use glam::Vec3;

#[cfg(test)]
mod tests;

/// The rays' normals, and the samples that wait for their gradient; all empty where nobody asks.
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

/// Lengths of the slices.
struct Sizes {
    rays: usize,
    samples: usize,
    signs: usize,
    encoded: usize,
}

impl Sizes {
    fn of(network: &Network<'_>, plan: &Plan<'_>) -> Self {
        if !plan.outputs.normals {
            return Self { rays: 0, samples: 0, signs: 0, encoded: 0 };
        }
        let samples = block_samples(network, plan);
        let (signs, encoded) = (network.sign_words(samples), network.gradient_rows() * samples);
        Self { rays: plan.batch.rays, samples, signs, encoded }
    }

    fn lines(&self) -> usize {
        lines_for::<NormalSum>(self.rays)
            + lines_for::<u32>(self.samples)
            + lines_for::<f32>(self.samples) * 2
            + lines_for::<u16>(self.signs)
            + lines_for::<f32>(self.encoded)
            + lines_for::<f32>(3 * self.samples)
    }
}

impl<'w> Normals<'w> {
    /// Lines of workspace.
    pub fn lines(network: &Network<'_>, plan: &Plan<'_>) -> usize {
        Sizes::of(network, plan).lines()
    }

    pub fn carve(arena: &mut Arena<'w>, network: &Network<'_>, plan: &Plan<'_>) -> Option<Self> {
        let sizes = Sizes::of(network, plan);
        let (sums, owner) = (arena.slice(sizes.rays, NormalSum::NONE)?, arena.slice(sizes.samples, 0u32)?);
        let signs = arena.slice(sizes.signs, 0u16)?;
        let mut floats = |count| arena.slice(count, 0.0f32);
        Some(Self {
            sums,
            queue: Queue { owner, t: floats(sizes.samples)?, weight: floats(sizes.samples)?, count: 0 },
            memory: GradientScratch { signs, encoded: floats(sizes.encoded)? },
            gradient: floats(3 * sizes.samples)?,
        })
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
