//! The state of one call: its memory, a tile's rays from pixel to pixel, the network's blocks.

use super::march::{Block, ColourQueue, Picks, RayState, Waiting};
use super::proposal::{Drawn, Proposer};
use super::surface::{Medians, Normals};
use super::{Counters, Rect, RenderError, Target};
use crate::camera::Camera;
use crate::effects::anti_aliasing::{self, Sums};
use crate::effects::depth_of_field;
use crate::effects::jitter::Place;
use crate::effects::tone;
use crate::kernels::{Arena, BLOCK, Line, at, column, head, head_mut, lines_for, put, put_column, tail};
use crate::math::Math;
use crate::network::{Network, Scratch};
use crate::plan::Plan;
use crate::ray::{Ray, SceneBox};
use glam::Vec3;

/// Columns of the widest vector: a block of prepared weights has a multiple of it.
const VECTOR: usize = 16;

/// Lengths of the slices a frame works in; the workspace query and the carving share them.
pub(super) struct Sizes {
    rays: usize,
    samples: usize,
    encoded: usize,
    activation: usize,
    /// Samples picked out of a block: 0 where a density is all that is asked of one.
    picks: usize,
    /// Colours worked out at once: 0 where none is asked for.
    colours: usize,
    /// Samples that may wait for their colour: 0 where one is a block.
    queue: usize,
    queued_activation: usize,
    direction: usize,
    /// Lines of what median distances and normals need.
    surface: usize,
    /// Lines of the pixels' sums: 0 where a pixel is one ray.
    sums: usize,
    /// Samples of a ray that are kept because they were drawn: 0 without a proposal.
    row: usize,
}

impl Sizes {
    pub(super) fn of(network: &Network<'_>, proposer: &Proposer<'_>, plan: &Plan<'_>) -> Self {
        let samples = block_samples(network, plan);
        let rays = plan.batch.rays;
        let colours = if plan.outputs.rgb { samples } else { 0 };
        let queue = if colours > 1 { colours } else { 0 };
        let direction_rows = if plan.outputs.rgb { network.direction_rows() } else { 0 };
        let row = proposer.row(plan);
        let (encoded, activation) = if row > 0 { proposer.rows() } else { (0, 0) };
        Self {
            rays,
            samples,
            encoded: network.encoded_rows().max(encoded) * samples,
            activation: network.activation_rows().max(activation) * samples,
            picks: if plan.outputs.picks() { samples } else { 0 },
            colours,
            queue,
            queued_activation: network.activation_rows() * queue,
            direction: direction_rows.saturating_mul(rays.div_ceil(samples.max(1)) * samples),
            surface: Medians::lines(plan) + Normals::lines(network, plan),
            sums: Sums::lines(&plan.effects, plan.outputs.surface(), rays),
            row,
        }
    }

    pub(super) fn lines(&self) -> usize {
        lines_for::<RayState>(self.rays)
            + lines_for::<u32>(self.rays)
            + lines_for::<u32>(self.samples)
            + lines_for::<f32>(self.samples) * 2
            + lines_for::<f32>(3 * self.samples) * 2
            + lines_for::<f32>(self.encoded)
            + lines_for::<f32>(self.activation) * 2
            + lines_for::<u32>(self.picks) * 2
            + lines_for::<f32>(self.picks)
            + lines_for::<f32>(3 * self.colours)
            + lines_for::<u32>(self.queue)
            + lines_for::<f32>(self.queue)
            + lines_for::<f32>(self.queued_activation)
            + lines_for::<f32>(self.direction)
            + self.surface
            + self.sums
            + Drawn::lines([self.rays, self.samples, self.row])
    }
}

/// The state of one `render` call.
pub(super) struct Frame<'f, 'w> {
    pub(super) plan: &'f Plan<'f>,
    pub(super) network: &'f Network<'f>,
    /// A box around what the occupancy grid has.
    occupied: Option<SceneBox>,
    /// The tile's rays that meet something live; they stay where they are until the tile is done.
    pub(super) rays: &'w mut [RayState],
    pub(super) waiting: Waiting<'w>,
    pub(super) drawn: Drawn<'f, 'w>,
    pub(super) block: Block<'w>,
    pub(super) picks: Picks<'w>,
    pub(super) queue: ColourQueue<'w>,
    pub(super) medians: Medians<'w>,
    pub(super) normals: Normals<'w>,
    /// `[3][stride]`: positions of a block; once the network has them, `[3][samples]`: where each sample counts as, the
    /// middle of its bin and its width, world units along the ray.
    pub(super) positions: &'w mut [f32],
    /// `[3][stride]`: colours of a block.
    pub(super) rgb: &'w mut [f32],
    /// `[3][samples]`: directions of a block of rays; once they walk, of each sample of a block the optical thickness in
    /// front of it, what it keeps of the light, and what is left of that behind it.
    pub(super) triples: &'w mut [f32],
    pub(super) shares: Shares<'w>,
    /// `stride` is that of the block at work: no more columns than its samples need.
    pub(super) scratch: Scratch<'w>,
    pub(super) counters: Counters,
    sums: Sums<'w>,
    /// Which of their pixels' rays are in flight: the first, the second, and on.
    pub(super) turn: u32,
    tile: Rect,
    /// The distance of a pixel without a surface.
    far: f32,
    /// What the camera looks along.
    forward: Vec3,
}

impl<'f, 'w> Frame<'f, 'w> {
    pub(super) fn carve(
        network: &'f Network<'f>,
        proposer: &'f Proposer<'f>,
        plan: &'f Plan<'f>,
        occupied: Option<SceneBox>,
        lines: &'w mut [Line],
    ) -> Result<Self, RenderError> {
        let sizes = Sizes::of(network, proposer, plan);
        let too_small = RenderError::Memory { expected: sizes.lines(), found: lines.len() };
        if lines.len() < sizes.lines() {
            return Err(too_small);
        }
        let mut arena = Arena::new(lines);
        let rays = arena.slice(sizes.rays, RayState::NONE).ok_or(too_small)?;
        let medians = Medians::carve(&mut arena, plan).ok_or(too_small)?;
        let normals = Normals::carve(&mut arena, network, plan).ok_or(too_small)?;
        let sums =
            Sums::carve(&mut arena, &plan.effects, plan.outputs.surface(), sizes.rays).ok_or(too_small)?;
        let drawn =
            Drawn::carve(proposer, &mut arena, [sizes.rays, sizes.samples, sizes.row]).ok_or(too_small)?;
        let mut numbers = |count| arena.slice(count, 0u32).ok_or(too_small);
        let (ring, owner) = (numbers(sizes.rays)?, numbers(sizes.samples)?);
        let (column, picked_owner) = (numbers(sizes.picks)?, numbers(sizes.picks)?);
        let queued_owner = numbers(sizes.queue)?;
        let mut floats = |count| arena.slice(count, 0.0f32).ok_or(too_small);
        Ok(Self {
            plan,
            network,
            occupied,
            rays,
            waiting: Waiting::new(ring),
            drawn,
            block: Block { owner, t: floats(sizes.samples)?, sigma: floats(sizes.samples)? },
            picks: Picks { column, owner: picked_owner, weight: floats(sizes.picks)? },
            queue: ColourQueue {
                h: floats(sizes.queued_activation)?,
                owner: queued_owner,
                weight: floats(sizes.queue)?,
                count: 0,
            },
            medians,
            normals,
            positions: floats(3 * sizes.samples)?,
            rgb: floats(3 * sizes.colours)?,
            triples: floats(3 * sizes.samples)?,
            shares: Shares { values: floats(sizes.direction)?, block: sizes.samples },
            scratch: Scratch {
                stride: sizes.samples,
                encoded: floats(sizes.encoded)?,
                front: floats(sizes.activation)?,
                back: floats(sizes.activation)?,
            },
            counters: Counters::default(),
            sums,
            turn: 0,
            tile: Rect { x: 0, y: 0, width: 0, height: 0 },
            far: plan.far,
            forward: Vec3::ZERO,
        })
    }

    /// Renders one tile of at most `plan.batch.rays` pixels, a ray of every pixel at a time.
    pub(super) fn tile<M: Math>(&mut self, camera: &Camera, tile: Rect, target: &mut impl Target) {
        self.tile = tile;
        self.far = self.plan.far_from(camera.pose().position);
        self.forward = camera.pose().forward();
        for turn in 0..anti_aliasing::rays(&self.plan.effects) {
            self.turn = turn;
            let mut hits = self.start::<M>(camera, target);
            if self.drawn.is_on() {
                hits = self.propose::<M>(hits, target);
            }
            self.directions(hits);
            while self.step::<M>() {}
            self.flush_colour();
            self.flush_normals();
            for i in 0..hits {
                let Some(&state) = self.rays.get(i) else { break };
                self.finish::<M>(&state, Some(i), target);
            }
        }
    }

    /// Makes the tile's rays; those that meet nothing are finished at once. Returns how many do.
    fn start<M: Math>(&mut self, camera: &Camera, target: &mut impl Target) -> usize {
        let (plan, tile, turn) = (self.plan, self.tile, self.turn);
        let (right, down) = anti_aliasing::offset(&plan.effects, turn);
        let area = depth_of_field::area(&plan.effects, turn);
        let mut hits = 0;
        // Nothing outside is live, so that most rays of most pictures end here.
        let walk = plan.proposal.as_ref().unwrap_or(&plan.bins);
        let around = if plan.occupancy.is_some() { self.occupied } else { Some(plan.bounds) };
        for y in tile.y..tile.y + tile.height {
            for x in tile.x..tile.x + tile.width {
                self.counters.rays += 1;
                let ray = camera.ray(x as f32 + right, y as f32 + down);
                let ray = depth_of_field::through_lens(&plan.effects, camera.pose(), ray, (x, y), area);
                let mut state = RayState { ray, x, y, done: false, ..RayState::NONE };
                if let Some(span) = around.and_then(|bounds| plan.span(&bounds, &ray)) {
                    (state.ray, state.start, state.ends) = (span.ray, span.start, span.ends);
                    (state.next, state.end) = (span.bins.start, span.bins.end);
                }
                let (next, end) = (state.next, state.end);
                // A proposal is asked in the middle of its bins.
                let place = if self.drawn.is_on() { Place::MIDDLE } else { state.place(plan, turn) };
                let live = state.seek(self.network.tier(), plan, walk, place);
                // Between the proposal's samples there may be drawn ones that are live.
                if (live || (self.drawn.is_on() && next < end))
                    && let Some(place) = self.rays.get_mut(hits)
                {
                    *place = state;
                    self.medians.begin(hits);
                    self.normals.begin(hits);
                    if live {
                        self.waiting.push(hits as u32);
                    }
                    hits += 1;
                } else {
                    self.finish::<M>(&state, None, target);
                }
            }
        }
        hits
    }

    /// The direction's share of the colour branch, for the first `count` rays.
    fn directions(&mut self, count: usize) {
        if self.shares.values.is_empty() {
            return;
        }
        let (rows, stride) = (self.network.direction_rows(), self.shares.block);
        let Scratch { encoded, front, back, .. } = &mut self.scratch;
        let mut scratch = Scratch { stride, encoded, front, back: &mut [] };
        let shares = self.shares.values.chunks_exact_mut((rows * stride).max(1));
        for (states, out) in head(self.rays, count).chunks(stride.max(1)).zip(shares) {
            for (column, state) in states.iter().enumerate() {
                put_column(self.triples, stride, column, state.ray.dir.to_array());
            }
            self.network.direction(self.plan.math, &mut scratch, self.triples, back);
            // Each ray's side by side: they are copied to every sample of it.
            for (column, share) in out.chunks_exact_mut(rows.max(1)).take(states.len()).enumerate() {
                for (to, from) in share.iter_mut().zip(back.chunks_exact(stride.max(1))) {
                    *to = at(from, column);
                }
            }
        }
        self.counters.macs += count as u64 * self.network.direction_macs() as u64;
    }

    /// Trunk and density of the block's `n` samples; its positions have the stride of `n`.
    pub(super) fn evaluate_density(&mut self, n: usize) {
        self.scratch.stride = columns_of(self.network, n);
        self.network.trunk(self.plan.math, &mut self.scratch, self.positions);
        self.network.density(self.plan.math, &self.scratch, self.block.sigma);
        self.counters.add_density(self.network, n);
    }

    /// Colours of the block whose trunk has just run; its first `n` columns are the picks, in order.
    pub(super) fn evaluate_colour(&mut self, n: usize) {
        let owner = head(self.picks.owner, n);
        self.shares.colour(self.network, self.plan, &mut self.scratch, owner, self.rgb);
        self.counters.add_colour(self.network, n);
    }

    /// Adds a finished ray to its pixel, and hands that on after its last; `place` is where the ray stood, if
    /// it met something.
    pub(super) fn finish<M: Math>(
        &mut self,
        state: &RayState,
        place: Option<usize>,
        target: &mut impl Target,
    ) {
        let (plan, tile) = (self.plan, self.tile);
        self.counters.samples_skipped += u64::from(plan.samples_per_ray().saturating_sub(state.kept));
        let cosine = state.ray.dir.dot(self.forward);
        let background = if plan.outputs.rgb { plan.background } else { [0.0; 3] };
        let mut seen = state.gathered.finish_from(state.start, state.done, background, self.far, cosine);
        seen.rgb = tone::to_light::<M>(&plan.effects.tone, seen.rgb);
        seen.median_distance = self.medians.finish(place, plan, state.start, self.far);
        seen.normal = self.normals.finish(place, seen.opacity);
        let index = (state.y - tile.y) as usize * tile.width as usize + (state.x - tile.x) as usize;
        if let Some(mut pixel) = self.sums.add(&plan.effects, index, self.turn, seen, self.far) {
            pixel.rgb = tone::to_display::<M>(&plan.effects.tone, pixel.rgb);
            target.put(state.x, state.y, &pixel);
        }
    }

    /// Density and colour at up to one block of points.
    pub(super) fn points(
        &mut self,
        positions: &[[f32; 3]],
        dirs: &[[f32; 3]],
        sigma: &mut [f32],
        rgb: &mut [[f32; 3]],
    ) {
        sigma.fill(0.0);
        rgb.fill([0.0; 3]);
        let mut n = 0;
        for (i, (&p, &dir)) in positions.iter().zip(dirs).enumerate() {
            let (origin, dir) = (self.plan.inside(p.into()), Vec3::from(dir));
            if self.plan.live(origin)
                && let Some(place) = self.rays.get_mut(n)
            {
                *place = RayState { ray: Ray { origin, dir }, x: i as u32, ..RayState::NONE };
                n += 1;
            }
        }
        if n == 0 {
            return;
        }
        self.directions(n);
        let stride = columns_of(self.network, n);
        for column in 0..stride {
            let state = at(self.rays, column.min(n - 1));
            put_column(self.positions, stride, column, state.ray.origin.to_array());
        }
        self.evaluate_density(n);
        if self.plan.outputs.rgb {
            for (column, owner) in head_mut(self.picks.owner, n).iter_mut().enumerate() {
                *owner = column as u32;
            }
            self.evaluate_colour(n);
        }
        for (i, state) in head(self.rays, n).iter().enumerate() {
            let colour = match self.plan.outputs.rgb {
                true => column(self.rgb, stride, i),
                false => [0.0f32; 3],
            };
            // As in a picture: without a number there is no density, and no colour; both are counted.
            let density = at(self.block.sigma, i);
            if density.is_nan() {
                self.counters.invalid_samples += 1;
                continue;
            }
            put(sigma, state.x as usize, density);
            if colour.iter().any(|c| c.is_nan()) {
                self.counters.invalid_samples += u64::from(density > 0.0);
            } else {
                put(rgb, state.x as usize, colour);
            }
        }
    }
}

/// The direction's share of the colour branch, once a ray: `[rays][direction_rows]`, room for whole blocks of rays.
pub(super) struct Shares<'w> {
    values: &'w mut [f32],
    block: usize,
}

impl Shares<'_> {
    /// Colours of the samples whose `h` is in `scratch.front`; `owner` says whose they are.
    ///
    /// `rgb`: `[3][scratch.stride]`.
    pub fn colour(
        &self,
        network: &Network<'_>,
        plan: &Plan<'_>,
        scratch: &mut Scratch<'_>,
        owner: &[u32],
        rgb: &mut [f32],
    ) {
        let (stride, rows) = (scratch.stride, network.direction_rows());
        let spread = |to: &mut [f32]| {
            for (column, &ray) in owner.iter().enumerate() {
                let share = head(tail(self.values, ray as usize * rows), rows);
                for (to, &value) in to.chunks_exact_mut(stride.max(1)).zip(share) {
                    put(to, column, value);
                }
            }
        };
        network.colour(plan.math, scratch, spread, rgb);
    }
}

/// Samples of a block.
pub(super) fn block_samples(network: &Network<'_>, plan: &Plan<'_>) -> usize {
    if network.whole_blocks() { BLOCK } else { plan.batch.samples }
}

/// Columns that `n` samples take: as many as they are, or whole vectors on the tiers that need them.
///
/// A column's result does not depend on how many stand beside it.
pub(super) fn columns_of(network: &Network<'_>, n: usize) -> usize {
    if network.whole_blocks() { n.next_multiple_of(VECTOR) } else { n }
}
