//! Ray marching: fills each block with the active rays' next samples in occupied cells.
//!
//! Usually a block holds at most one sample of each ray: the ray's transmittance is then known before its next sample
//! is evaluated. If fewer than [`MAX_LANES`] rays are active, each ray puts several samples into the block. If one of
//! these samples ends the ray, the ray's later samples are dropped and not counted: pixels and counters do not depend
//! on the number of samples that a ray puts into a block.

use super::coarse::{CandidateBins, Intervals, Packets};
use super::ray::{ActiveRays, MarchAll, ProposalSamples, RayState, windows};
use crate::camera::Ray;
use crate::memory::{Layout, head, head_mut, put};
use crate::plan::{Lattice, Plan, Span, SpanAll, Spans};
use crate::render::field::Field;
use crate::render::pixel::{PixelRay, Pixels, RaySource, Rect, Target};
use crate::sampling::SampleJitter;
use crate::simd::{MAX_LANES, VECTORS};
use crate::space::SceneBox;
use crate::volume::Accumulator;

/// Width and height of a packet of neighbouring rays, pixels. A packet is tested against the coarse occupancy grid as a
/// whole, and must not have more than [`MAX_LANES`] rays. In a tile one pixel high, a packet is a row of 16 rays.
const PACKET: (u32, u32) = (4, 4);

/// The rays of the current tile that may have a sample in an occupied cell.
pub(in crate::render) struct Rays<'f, 'w> {
    field: Field<'f>,
    /// Box around all occupied cells of the occupancy grid; `None` without a grid or if no cell is occupied.
    occupied: Option<SceneBox>,
    /// Whether all cells at the faces of the scene box are empty (`LookUp::inner`). Always `false` in builds without
    /// vector instructions, to keep these builds small.
    inner: bool,
    packets: [Option<Packets<'f>>; VECTORS as usize],
    pub states: &'w mut [RayState],
    /// Number of rays of the tile that are stored, at the start of `states`. Other rays have no sample in an occupied
    /// cell.
    pub hits: usize,
    pub active: ActiveRays<'w>,
    pub samples: ProposalSamples<'w>,
    /// Index, within its pixel, of the ray that is currently rendered. The pixels of a tile all have the same current
    /// index.
    pub turn: u32,
}

impl<'f, 'w> Rays<'f, 'w> {
    /// Reserves memory for a batch of rays. `occupied`: box around all occupied cells. `packets`: the packet test;
    /// `None` if it is not used. `drawn`: number of values that [`ProposalSamples`] stores for each ray; 0 without a
    /// proposal network.
    pub fn lay_out(
        layout: &mut impl Layout<'w>,
        field: Field<'f>,
        (occupied, packets): (Option<SceneBox>, Option<Packets<'f>>),
        drawn: usize,
    ) -> Self {
        let (plan, rays) = (field.plan, field.plan.batch.rays);
        let inner = |SceneBox { min, max }: SceneBox| {
            min.cmpgt(plan.bounds.min).all() && max.cmplt(plan.bounds.max).all()
        };
        Self {
            field,
            occupied,
            inner: VECTORS && occupied.is_some_and(inner),
            packets: [packets; VECTORS as usize],
            states: layout.slice(rays, RayState::NONE),
            hits: 0,
            active: ActiveRays::new(layout.slice(rays, 0)),
            samples: ProposalSamples::lay_out(layout, [rays, field.block_samples(), drawn]),
            turn: 0,
        }
    }

    /// Takes the ray of each pixel from `source`, and marches the ray to its first sample in an occupied cell. If a ray
    /// has no such sample, adds the ray's result to its pixel at once. `COLLIDE`: whether rays end at random
    /// collisions.
    pub fn start<const COLLIDE: bool>(
        &mut self,
        pixels: &mut Pixels<'_, '_>,
        source: &dyn RaySource,
        target: &mut dyn Target,
    ) {
        let tile = pixels.tile;
        (self.hits, self.turn) = (0, pixels.turn);
        let packets = self.packets.first().copied().flatten();
        let unbounded = VECTORS && self.field.plan.lattice == Lattice::Contracted && !self.samples.is_on();
        if (packets.is_some() || unbounded) && tile.width * tile.height > 1 {
            let (across, down) = if tile.height > 1 { PACKET } else { (PACKET.0 * PACKET.1, 1) };
            for part in tile.tiles(across, down) {
                self.start_packet::<COLLIDE>(packets.as_ref(), part, pixels, source, target);
            }
            return;
        }
        for y in tile.y..tile.y + tile.height {
            for x in tile.x..tile.x + tile.width {
                self.start_ray::<COLLIDE>((x, y), source.ray(x, y), pixels, source, target);
            }
        }
    }

    /// Starts the rays of the pixels in `part` as [`Rays::start`] does, all at once. `packets`: the packet test; `None`
    /// in an unbounded scene.
    fn start_packet<const COLLIDE: bool>(
        &mut self,
        packets: Option<&Packets<'_>>,
        part: Rect,
        pixels: &mut Pixels<'_, '_>,
        source: &dyn RaySource,
        target: &mut dyn Target,
    ) {
        let (plan, isa) = (self.field.plan, self.field.isa());
        let mut rays = [PixelRay::NONE.ray; MAX_LANES];
        let rays = head_mut(&mut rays, (part.width * part.height) as usize);
        source.rays(isa, part, rays);
        let (rays, mut ranges) = (&*rays, [[0.0; MAX_LANES]; 2]);
        for (i, ((x, y), ray)) in part.pixels().zip(rays).enumerate() {
            let [t_min, t_max] = source.range(x, y, ray);
            [ranges[0][i], ranges[1][i]] = plan.range_of(t_min, t_max);
        }
        pixels.counters.rays += rays.len() as u64;
        let intervals = packets.map_or(Some(Intervals::ALL), |packets| packets.intervals_of(isa, rays));
        let Some(intervals) = intervals else {
            for ((pixel, ray), end) in part.pixels().zip(rays).zip(ranges[1]) {
                pixels.miss(pixel, source.far(ray).min(end), target);
            }
            return;
        };
        let (around, mut spans) = (self.occupied.unwrap_or(plan.bounds), Spans::NONE);
        isa.run(SpanAll { plan, around: &around, rays, ranges: &ranges, to: &mut spans });
        let (mut list, mut count, mut hits) = ([0; MAX_LANES], 0, self.hits);
        for (i, (pixel, &ray)) in part.pixels().zip(rays).enumerate() {
            let Some(state) = self.states.get_mut(hits + count) else { break };
            let (range, span) = ([ranges[0][i], ranges[1][i]], spans.of(i, &ray));
            begin::<COLLIDE>(plan, pixel, (ray, range, span), &intervals, source, state);
            if state.next < state.end {
                put(&mut list, count, (hits + count) as u32);
                count += 1;
            } else {
                pixels.miss(pixel, state.pixel.range[1], target);
            }
        }
        let list = head(&list, count);
        self.march_all(list);
        for from in list.iter().map(|&from| from as usize) {
            let Some(&state) = self.states.get(from) else { break };
            if state.next < state.end {
                if from != hits {
                    put(self.states, hits, state);
                }
                self.active.push(hits as u32);
                hits += 1;
            } else {
                let PixelRay { x, y, range, .. } = state.pixel;
                pixels.miss((x, y), range[1], target);
            }
        }
        self.hits = hits;
    }

    /// Starts the ray of one pixel, as [`Rays::start`] does. Appends the ray to `states`, or, if the ray cannot have a
    /// sample in an occupied cell, adds the ray's result to the pixel.
    #[inline(never)]
    fn start_ray<const COLLIDE: bool>(
        &mut self,
        pixel: (u32, u32),
        ray: Ray,
        pixels: &mut Pixels<'_, '_>,
        source: &dyn RaySource,
        target: &mut dyn Target,
    ) {
        let (plan, isa) = (self.field.plan, self.field.isa());
        let [t_min, t_max] = source.range(pixel.0, pixel.1, &ray);
        let range = plan.range_of(t_min, t_max);
        pixels.counters.rays += 1;
        let Some(state) = self.states.get_mut(self.hits) else { return };
        let around = if plan.occupancy.is_some() { self.occupied } else { Some(plan.bounds) };
        // Cells outside of `around` are empty. Most rays of most images miss `around` and have no span.
        let span = around.and_then(|around| Span::new(plan, &around, &ray, range));
        // No packet test: for a single ray the test takes longer than the lookups that it saves.
        begin::<COLLIDE>(plan, pixel, (ray, range, span), &Intervals::ALL, source, state);
        let (drawn, meets_box) = (self.samples.is_on(), state.next < state.end);
        // A proposal is evaluated in the middle of its bins.
        let jitter = if drawn { SampleJitter::MIDDLE } else { state.pixel.jitter(plan, self.turn) };
        let occupied = state.march(isa, plan, plan.marched_bins(), jitter);
        if occupied {
            self.active.push(self.hits as u32);
        }
        // Samples drawn between the middles of the proposal's bins may be occupied even if no middle is.
        if occupied || (drawn && meets_box) {
            self.hits += 1;
        } else {
            pixels.counters.samples_skipped += u64::from(plan.samples_per_ray());
            pixels.finish(&state.pixel, None, target);
        }
    }

    /// Marches each ray with an index in `list` to its next sample in an occupied cell.
    pub fn march_all(&mut self, list: &[u32]) {
        let (plan, isa) = (self.field.plan, self.field.isa());
        if let Some(occupancy) = windows(isa, plan) {
            let (contraction, bins) = (plan.contraction.as_ref(), &plan.bins);
            let (rays, inner) = (&mut *self.states, self.inner);
            return isa.run(MarchAll { occupancy, contraction, bins, rays, list, inner });
        }
        for &ray in list {
            if let Some(state) = self.states.get_mut(ray as usize) {
                state.march(isa, plan, &plan.bins, state.pixel.jitter(plan, self.turn));
            }
        }
    }

    /// Fills a block with at most `room` samples of the active rays and returns the number of samples. Passes each
    /// sample's column, ray index and position along the ray ([`ProposalSamples::take`]) to `put`.
    ///
    /// Number of samples that each ray contributes:
    /// - if no sample can end a ray, since there is neither a transmittance cut nor collisions: all its remaining
    ///   samples, as far as there is room;
    /// - else, if fewer than [`MAX_LANES`] rays are active: several samples, at most as many as the smallest block has
    ///   columns ([`Field::columns`]);
    /// - else one sample.
    ///
    /// `COLLIDE`: whether rays end at random collisions.
    pub fn take<const COLLIDE: bool>(&mut self, room: usize, mut put: impl FnMut(usize, u32, f32)) -> usize {
        let (field, plan) = (self.field, self.field.plan);
        let burst = match field.columns(1) {
            _ if plan.transmittance_cut == 0.0 && !COLLIDE => room,
            columns => (MAX_LANES / self.active.len().max(1)).clamp(1, columns),
        };
        let mut n = 0;
        while n < room {
            let Some(i) = self.active.pop() else { break };
            let Some(state) = self.states.get_mut(i as usize) else { break };
            for taken in 0..burst.min(room - n) {
                let jitter = state.pixel.jitter(plan, self.turn);
                // The next sample of an active ray is always occupied.
                if taken > 0 && !self.samples.march(field, i, state, jitter) {
                    break;
                }
                put(n, i, self.samples.take(field, i, state, jitter, n));
                state.next += 1;
                n += 1;
            }
        }
        n
    }
}

/// Sets `state` to the start of a pixel's ray. `intervals`: intervals along the ray in which occupied cells may lie.
/// `COLLIDE`: whether the ray ends where its optical thickness reaches [`RaySource::until`] of `source`.
// Inlined, so that span and candidate bins are not copied through memory: a view takes 6 % less time.
#[inline(always)]
fn begin<const COLLIDE: bool>(
    plan: &Plan<'_>,
    pixel: (u32, u32),
    (ray, range, span): (Ray, [f32; 2], Option<Span>),
    intervals: &Intervals,
    source: &dyn RaySource,
    state: &mut RayState,
) {
    state.begin(pixel, ray, [range[0], range[1].min(source.far(&ray))], span);
    if COLLIDE {
        state.pixel.gathered = Accumulator::until(source.until(pixel.0));
    }
    if state.next < state.end {
        for candidates in &mut state.candidates {
            *candidates = CandidateBins::new(intervals, plan.marched_bins(), state.pixel.start);
            state.end = state.end.min(candidates.end());
            state.next = candidates.next(state.next).min(state.end);
        }
    }
}
