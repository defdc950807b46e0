//! The state of a worker: its memory, a tile's rays from pixel to pixel, the network's blocks.

use super::coarse::{CandidateBins, Intervals, Packets};
use super::deferred::{Deferred, is_deferred};
use super::directions::DirectionShares;
use super::march::{ActiveRays, Block, ColourQueue, Picks, RayState};
use super::proposal::{ProposalSamples, Proposer};
use super::side_by_side::column_rows;
use super::source::{CameraRays, OwnRays, RaySource};
use super::surface::{Medians, Normals};
use super::{Counters, Limit, RaySegment, Rect, Target};
use crate::camera::{Camera, Ray};
use crate::math::Math;
use crate::memory::{Layout, at, head, head_mut, put, tail_mut};
use crate::network::{Network, Scratch};
use crate::plan::{Plan, Span, SpanAll, Spans};
use crate::render::anti_aliasing::{self, Sums};
use crate::render::tone;
use crate::sampling::SampleJitter;
use crate::simd::{BLOCK, MAX_LANES, VECTORS};
use crate::space::SceneBox;
use crate::volume::{Accumulator, Pixel};
use glam::Vec3;

/// Rays that are looked up in the coarse occupancy grid together, across and down; of a row as many. No more than
/// [`MAX_LANES`].
const PACKET: (u32, u32) = (4, 4);

/// What a worker works with, from its memory to the tile at hand.
pub(super) struct Frame<'f, 'w> {
    pub(super) plan: &'f Plan<'f>,
    pub(super) network: &'f Network<'f>,
    /// A box around what the occupancy grid has.
    occupied: Option<SceneBox>,
    /// Whether no cell at a face of the scene box is occupied; always `false` in builds without vectors, which shortens their code.
    pub(super) inner: bool,
    packets: [Option<Packets<'f>>; VECTORS as usize],
    /// The tile's rays that meet something live; they stay where they are until the tile is done.
    pub(super) rays: &'w mut [RayState],
    pub(super) active: ActiveRays<'w>,
    pub(super) drawn: ProposalSamples<'f, 'w>,
    pub(super) block: Block<'w>,
    pub(super) picks: Picks<'w>,
    pub(super) queue: ColourQueue<'w>,
    pub(super) deferred: Deferred<'w>,
    /// `[column_rows][BLOCK]`: rays that are marched side by side.
    pub(super) columns: &'w mut [f32],
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
    pub(super) shares: DirectionShares<'w>,
    /// `stride` is that of the block at work: no more columns than its samples need.
    pub(super) scratch: Scratch<'w>,
    pub(super) counters: Counters,
    sums: Sums<'w>,
    /// Which of their pixels' rays are in flight: the first, the second, and on.
    pub(super) turn: u32,
    tile: Rect,
    /// Whether colour is over the background.
    pub(super) background: bool,
    /// What z_depth is measured along.
    forward: Vec3,
}

impl<'f, 'w> Frame<'f, 'w> {
    /// All memory of a frame: measured and carved by this list alone.
    pub(super) fn lay_out(
        layout: &mut impl Layout<'w>,
        network: &'f Network<'f>,
        proposer: &'f Proposer<'f>,
        plan: &'f Plan<'f>,
        (occupied, packets): (Option<SceneBox>, Option<Packets<'f>>),
    ) -> Self {
        let (rays, samples) = (plan.batch.rays, block_samples(network, plan));
        let picks = if plan.outputs.picks() { samples } else { 0 };
        let at_samples = plan.outputs.rgb && !is_deferred(network, plan);
        let colours = if at_samples { samples } else { 0 };
        // Where a block is one sample, none waits for others.
        let queue = if colours > 1 { colours } else { 0 };
        let direction_rows = if at_samples { network.direction_rows() } else { 0 };
        let row = proposer.row(plan);
        let (encoded, activation) = if row > 0 { proposer.rows() } else { (0, 0) };
        let encoded = network.encoded_rows().max(encoded) * samples;
        let activation = network.activation_rows().max(activation) * samples;
        let shares = direction_rows.saturating_mul(rays.div_ceil(samples.max(1)) * samples);
        Self {
            plan,
            network,
            occupied,
            inner: VECTORS
                && occupied.is_some_and(|SceneBox { min, max }| {
                    min.cmpgt(plan.bounds.min).all() && max.cmplt(plan.bounds.max).all()
                }),
            packets: [packets; VECTORS as usize],
            rays: layout.slice(rays, RayState::NONE),
            active: ActiveRays::new(layout.slice(rays, 0)),
            drawn: ProposalSamples::lay_out(layout, proposer, [rays, samples, row]),
            block: Block {
                owner: layout.slice(samples, 0),
                t: layout.slice(samples, 0.0),
                sigma: layout.slice(samples, 0.0),
            },
            picks: Picks {
                column: layout.slice(picks, 0),
                owner: layout.slice(picks, 0),
                weight: layout.slice(picks, 0.0),
            },
            queue: ColourQueue {
                h: layout.slice(network.activation_rows() * queue, 0.0),
                owner: layout.slice(queue, 0),
                weight: layout.slice(queue, 0.0),
                count: 0,
            },
            deferred: Deferred::lay_out(layout, network, plan),
            columns: layout.slice(column_rows(network, plan) * BLOCK, 0.0),
            medians: Medians::lay_out(layout, plan),
            normals: Normals::lay_out(layout, network, plan),
            positions: layout.slice(3 * samples, 0.0),
            rgb: layout.slice(3 * colours, 0.0),
            triples: layout.slice(3 * samples, 0.0),
            shares: DirectionShares { values: layout.slice(shares, 0.0), block: samples },
            scratch: Scratch {
                stride: samples,
                encoded: layout.slice(encoded, 0.0),
                front: layout.slice(activation, 0.0),
                back: layout.slice(activation, 0.0),
            },
            counters: Counters::default(),
            sums: Sums::lay_out(layout, &plan.effects, plan.outputs.surface(), rays),
            turn: 0,
            tile: Rect { x: 0, y: 0, width: 0, height: 0 },
            background: true,
            forward: Vec3::ZERO,
        }
    }

    /// Renders one tile of at most `plan.batch.rays` pixels, a ray of every pixel at a time.
    pub(super) fn tile<M: Math>(
        &mut self,
        camera: &Camera,
        tile: Rect,
        limit: &impl Fn(u32, u32) -> Limit,
        target: &mut impl Target,
    ) {
        let far = self.plan.far_from(camera.pose().position);
        (self.tile, self.forward) = (tile, camera.pose().forward());
        for turn in 0..anti_aliasing::rays(&self.plan.effects) {
            let source = CameraRays::new(camera, &self.plan.effects, turn, limit, far);
            self.turn::<M, false>(turn, &source, target);
        }
    }

    /// Renders up to `plan.batch.rays` rays from the `first` on as the pixels of a row; with `COLLIDE` each as far as its
    /// random number has it collide.
    pub(super) fn row_of_rays<M: Math, const COLLIDE: bool>(
        &mut self,
        (first, count): (usize, usize),
        ray: &impl Fn(usize) -> RaySegment,
        random: &impl Fn(usize) -> f32,
        axis: Vec3,
        target: &mut impl Target,
    ) {
        // Lossless: a plan has at most `Batch::MAX_RAYS`.
        self.tile = Rect { x: 0, y: 0, width: count as u32, height: 1 };
        self.forward = axis;
        let plan = self.plan;
        let far = |eye| plan.far_from(eye);
        self.turn::<M, COLLIDE>(0, &OwnRays { first, ray, random, far }, target);
    }

    /// The `turn`-th ray of each pixel of the tile.
    fn turn<M: Math, const COLLIDE: bool>(
        &mut self,
        turn: u32,
        source: &impl RaySource,
        target: &mut impl Target,
    ) {
        let plan = self.plan;
        self.turn = turn;
        let mut hits = self.start::<M, COLLIDE>(source, target);
        if self.drawn.is_on() {
            hits = self.propose::<M>(hits, source, target);
        }
        self.directions(hits);
        if !COLLIDE {
            self.march_side_by_side::<M>();
        }
        while self.step::<M, COLLIDE>() {}
        self.flush_colour();
        self.flush_normals();
        let rays = head_mut(self.rays, hits);
        self.deferred.shade(self.network, plan, &mut self.scratch, rays, &mut self.counters);
        for i in 0..hits {
            let Some(&state) = self.rays.get(i) else { break };
            self.finish::<M>(&state, Some(i), source, target);
        }
    }

    /// Makes the tile's rays; those that meet nothing are finished at once. Returns how many do.
    fn start<M: Math, const COLLIDE: bool>(
        &mut self,
        source: &impl RaySource,
        target: &mut impl Target,
    ) -> usize {
        let (mut hits, tile) = (0, self.tile);
        if let Some(&Some(packets)) = self.packets.first()
            && tile.width * tile.height > 1
        {
            let (across, down) = if tile.height > 1 { PACKET } else { (PACKET.0 * PACKET.1, 1) };
            for part in tile.tiles(across, down) {
                hits = self.start_packet::<M, COLLIDE>(&packets, part, hits, source, target);
            }
            return hits;
        }
        for y in tile.y..tile.y + tile.height {
            for x in tile.x..tile.x + tile.width {
                let ray = source.ray(x, y);
                hits += usize::from(self.start_ray::<M, COLLIDE>((x, y), ray, hits, source, target));
            }
        }
        hits
    }

    /// Makes the rays of a `part` of the tile, of which `hits` before them met something; returns how many do with them.
    fn start_packet<M: Math, const COLLIDE: bool>(
        &mut self,
        packets: &Packets<'_>,
        part: Rect,
        mut hits: usize,
        source: &impl RaySource,
        target: &mut impl Target,
    ) -> usize {
        let (mut rays, pixels) = ([RayState::NONE.ray; MAX_LANES], part.pixels());
        let rays = head_mut(&mut rays, (part.width * part.height) as usize);
        source.rays(self.network.isa(), part, rays);
        let rays = &*rays;
        let Some(intervals) = packets.intervals_of(self.network.isa(), rays) else {
            for (pixel, ray) in pixels.zip(rays) {
                self.finish_missed::<M>(pixel, ray, source, target);
            }
            return hits;
        };
        let (plan, occupied) = (self.plan, self.occupied.unwrap_or(self.plan.bounds));
        let (mut ranges, mut spans) = ([[0.0; MAX_LANES]; 2], Spans::NONE);
        for (i, ((x, y), ray)) in pixels.clone().zip(rays).enumerate() {
            let [t_min, t_max] = source.range(x, y, ray);
            [ranges[0][i], ranges[1][i]] = plan.range_of(t_min, t_max);
        }
        let (around, to) = (&occupied, &mut spans);
        self.network.isa().run(SpanAll { plan, around, rays, ranges: &ranges, to });
        let (mut list, mut count) = ([0; MAX_LANES], 0);
        for (i, (pixel, &ray)) in pixels.zip(rays).enumerate() {
            self.counters.rays += 1;
            let Some(state) = self.rays.get_mut(hits + count) else { break };
            let (range, span) = ([ranges[0][i], ranges[1][i]], spans.of(i, &ray));
            ray_of::<COLLIDE>(plan, pixel, (ray, range, span), &intervals, source, state);
            if state.next < state.end {
                put(&mut list, count, (hits + count) as u32);
                count += 1;
            } else {
                let state = *state;
                self.finish::<M>(&state, None, source, target);
            }
        }
        let list = head(&list, count);
        self.march_all(list);
        for from in list.iter().map(|&from| from as usize) {
            let Some(state) = self.rays.get(from) else { break };
            if state.next < state.end {
                if from != hits {
                    put(self.rays, hits, *state);
                }
                self.begin(hits, true);
                hits += 1;
            } else {
                let state = *state;
                self.finish::<M>(&state, None, source, target);
            }
        }
        hits
    }

    /// Starts the ray of a pixel: marches it to its first occupied sample and stores it as the tile's ray number `hits`.
    /// Returns `false` for a ray without one, which is finished at once.
    fn start_ray<M: Math, const COLLIDE: bool>(
        &mut self,
        pixel: (u32, u32),
        ray: Ray,
        hits: usize,
        source: &impl RaySource,
        target: &mut impl Target,
    ) -> bool {
        let (plan, turn, isa) = (self.plan, self.turn, self.network.isa());
        let walk = plan.proposal.as_ref().unwrap_or(&plan.bins);
        let mut intervals = Intervals::ALL;
        if let Some(Some(packets)) = self.packets.first() {
            let Some(found) = packets.intervals_of(isa, core::slice::from_ref(&ray)) else {
                self.finish_missed::<M>(pixel, &ray, source, target);
                return false;
            };
            intervals = found;
        }
        self.counters.rays += 1;
        let around = if plan.occupancy.is_some() { self.occupied } else { Some(plan.bounds) };
        let [t_min, t_max] = source.range(pixel.0, pixel.1, &ray);
        let range = plan.range_of(t_min, t_max);
        // Nothing outside is live, so that most rays of most pictures end here.
        let span = around.and_then(|around| plan.span(&around, &ray, range));
        let Some(state) = self.rays.get_mut(hits) else { return false };
        ray_of::<COLLIDE>(plan, pixel, (ray, range, span), &intervals, source, state);
        let (next, end) = (state.next, state.end);
        // A proposal is asked in the middle of its bins.
        let place = if self.drawn.is_on() { SampleJitter::MIDDLE } else { state.place(plan, turn) };
        let live = state.march(isa, plan, walk, place);
        // Between the proposal's samples there may be drawn ones that are live.
        if live || (self.drawn.is_on() && next < end) {
            self.begin(hits, live);
            return true;
        }
        let state = *state;
        self.finish::<M>(&state, None, source, target);
        false
    }

    /// The tile's ray number `ray` is a new one, which is `live`.
    fn begin(&mut self, ray: usize, live: bool) {
        self.deferred.begin(ray);
        self.medians.begin(ray);
        self.normals.begin(ray);
        if live {
            self.active.push(ray as u32);
        }
    }

    /// The direction's share of the colour branch, for the first `count` rays.
    pub(super) fn directions(&mut self, count: usize) {
        if !self.shares.values.is_empty() {
            let (rays, triples) = (head(self.rays, count), &mut *self.triples);
            self.shares.fill(self.network, self.plan.math, &mut self.scratch, triples, rays);
            self.counters.macs += count as u64 * self.network.direction_macs() as u64;
        }
    }

    /// Trunk and density of the block's `n` samples; its positions have the stride of `n`.
    pub(super) fn evaluate_density(&mut self, n: usize) {
        self.scratch.stride = columns_of(self.network, n);
        self.network.trunk(self.plan.math, &mut self.scratch, self.positions);
        self.network.density(self.plan.math, &self.scratch, self.block.sigma);
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
        source: &impl RaySource,
        target: &mut impl Target,
    ) {
        let (plan, far) = (self.plan, source.far(state.x).min(state.range[1]));
        self.counters.samples_skipped += u64::from(plan.samples_per_ray().saturating_sub(state.kept));
        let cosine = state.ray.dir.dot(self.forward);
        let background = self.background::<M>();
        let mut seen = state.gathered.finish_from(state.start, state.done, background, far, cosine);
        seen.rgb = tone::to_light::<M>(&plan.effects.tone, seen.rgb);
        seen.median_distance = self.medians.finish(place, plan, state.start, far);
        seen.normal = self.normals.finish(place, seen.opacity);
        self.add_to_pixel::<M>((state.x, state.y), seen, far, target);
    }

    /// [`Frame::finish`] of a ray that nothing was asked about: it meets nothing.
    fn finish_missed<M: Math>(
        &mut self,
        (x, y): (u32, u32),
        ray: &Ray,
        source: &impl RaySource,
        target: &mut impl Target,
    ) {
        let [t_min, t_max] = source.range(x, y, ray);
        let far = source.far(x).min(self.plan.range_of(t_min, t_max)[1]);
        self.counters.rays += 1;
        self.counters.samples_skipped += u64::from(self.plan.samples_per_ray());
        let rgb = tone::to_light::<M>(&self.plan.effects.tone, self.background::<M>());
        let median_distance = self.medians.finish(None, self.plan, 0.0, far);
        let seen = Pixel { rgb, ray_distance: far, z_depth: far, median_distance, ..Pixel::BLANK };
        self.add_to_pixel::<M>((x, y), seen, far, target);
    }

    /// What shows behind a ray.
    fn background<M: Math>(&self) -> [f32; 3] {
        let shown = self.plan.outputs.rgb && self.background;
        tone::background::<M>(&self.plan.effects.tone, if shown { self.plan.background } else { [0.0; 3] })
    }

    /// Adds what a ray saw to its pixel, and hands that on after its last.
    #[inline]
    fn add_to_pixel<M: Math>(&mut self, (x, y): (u32, u32), seen: Pixel, far: f32, target: &mut impl Target) {
        let (plan, tile) = (self.plan, self.tile);
        let index = (y - tile.y) as usize * tile.width as usize + (x - tile.x) as usize;
        if let Some(mut pixel) = self.sums.add(&plan.effects, index, self.turn, seen, far) {
            pixel.rgb = tone::to_display::<M>(&plan.effects.tone, pixel.rgb);
            target.put(x, y, &pixel);
        }
    }
}

/// Makes `state` that of a pixel's ray before its first sample. `intervals`: where along the ray occupied cells may be.
fn ray_of<const COLLIDE: bool>(
    plan: &Plan<'_>,
    (x, y): (u32, u32),
    (ray, range, span): (Ray, [f32; 2], Option<Span>),
    intervals: &Intervals,
    source: &impl RaySource,
    state: &mut RayState,
) {
    *state = RayState { ray, range, x, y, done: false, ..RayState::NONE };
    if COLLIDE {
        state.gathered = Accumulator::until(source.until(x));
    }
    if let Some(span) = span {
        (state.ray, state.start, state.ends) = (span.ray, span.start, span.ends);
        (state.next, state.end) = (span.bins.start, span.bins.end);
        for candidates in &mut state.candidates {
            let walk = plan.proposal.as_ref().unwrap_or(&plan.bins);
            *candidates = CandidateBins::new(intervals, walk, span.start);
            state.end = state.end.min(candidates.end());
            state.next = candidates.next(state.next).min(state.end);
        }
    }
}

/// Samples of a block.
pub(super) fn block_samples(network: &Network<'_>, plan: &Plan<'_>) -> usize {
    if network.whole_blocks() { BLOCK } else { plan.batch.samples }
}

/// Columns that `n` samples take: as many as they are, or a multiple of [`Network::columns`] for the kernels that need it.
///
/// A column's result does not depend on how many stand beside it.
pub(super) fn columns_of(network: &Network<'_>, n: usize) -> usize {
    if network.whole_blocks() { n.next_multiple_of(network.columns()) } else { n }
}

/// Puts copies of column `n - 1` of a block, `[rows][stride]`, into the columns that only fill it up.
pub(super) fn fill_up(block: &mut [f32], rows: usize, stride: usize, n: usize) {
    // Without vectors there are none.
    if VECTORS {
        for row in block.chunks_exact_mut(stride.max(1)).take(rows) {
            let last = at(row, n.saturating_sub(1));
            tail_mut(row, n).fill(last);
        }
    }
}
