//! Ray marching: each block takes the next occupied sample of as many active rays as it has room for.
//!
//! A ray has one sample in flight, so that its transmittance is known before the next one is evaluated. Where fewer rays
//! are active than a vector has columns, the next samples of the same rays take the rest, which would hold copies
//! otherwise; what turns out to lie behind the transmittance threshold is dropped and not counted. So the work of a frame
//! depends on the scene and the request alone, as its pixels do.

use super::Counters;
use super::coarse::CandidateBins;
use super::frame::{Frame, columns_of, fill_up};
use super::proposal::ProposalSamples;
use super::surface::Medians;
use super::window::{self, MarchAll, Window};
use crate::camera::Ray;
use crate::math::Math;
use crate::memory::{at, column, head, head_mut, put, put_column, tail, tail_mut};
use crate::network::Scratch;
use crate::plan::Plan;
use crate::sampling::{Bins, Ends, OccupancyGrid, SampleJitter};
use crate::simd::{Isa, Lanes, MAX_LANES, Op, VECTORS};
use crate::space::Contraction;
use crate::volume::{Accumulator, alpha, light, thickness};
use core::marker::PhantomData;
use glam::Vec3;

/// Of a block of which less than this is picked, the picks are collected first: numerator and denominator.
const QUEUED_BELOW: (usize, usize) = (3, 4);

/// What one ray carries from sample to sample.
#[derive(Clone, Copy)]
pub(super) struct RayState {
    /// From the point its samples are counted from.
    pub ray: Ray,
    /// How far that is along the ray.
    pub start: f32,
    /// The distances that are seen of it.
    pub range: [f32; 2],
    /// How the outermost of its bins are cut.
    pub ends: Ends,
    pub x: u32,
    pub y: u32,
    /// The next bin or proposal sample, and the end of them.
    pub next: u32,
    pub end: u32,
    /// The bins that were looked up in the occupancy grid.
    pub window: Window,
    /// The bins that may have a sample in an occupied cell; none is kept without vectors, where all may.
    pub candidates: [CandidateBins; VECTORS as usize],
    /// Samples that the network was evaluated at.
    pub kept: u32,
    /// Whether the transmittance is below the threshold.
    pub done: bool,
    pub gathered: Accumulator,
}

impl Default for RayState {
    fn default() -> Self {
        Self::NONE
    }
}

impl RayState {
    pub const NONE: Self = Self {
        ray: Ray { origin: Vec3::ZERO, dir: Vec3::NEG_Z },
        start: 0.0,
        range: [0.0, f32::MAX],
        ends: Ends::NONE,
        x: 0,
        y: 0,
        next: 0,
        end: 0,
        window: Window::NONE,
        candidates: [CandidateBins::ALL; VECTORS as usize],
        kept: 0,
        done: true,
        gathered: Accumulator::NONE,
    };

    /// Where its samples lie, if it is the `turn`-th ray of its pixel.
    #[inline]
    pub fn place(&self, plan: &Plan<'_>, turn: u32) -> SampleJitter {
        SampleJitter::of(plan.effects.jitter.map(|jitter| jitter.seed), self.x, self.y, turn)
    }

    /// Moves `next` to the first live one of `bins` at or after it; `false` if there is none.
    #[inline]
    pub fn march(&mut self, isa: Isa, plan: &Plan<'_>, bins: &Bins, place: SampleJitter) -> bool {
        if VECTORS && self.march_looked_up() {
            return true;
        }
        match windows(isa, plan, bins) {
            Some(occupancy) => {
                let (contraction, rays) = (plan.contraction.as_ref(), core::slice::from_mut(self));
                isa.run(MarchAll { occupancy, contraction, bins, rays, list: &[0], inner: false });
            }
            None => {
                let (bins, next, end) = (bins.with(self.ends), self.next, self.end);
                self.next = plan.first_occupied(&bins, &self.ray, place, next, end);
            }
        }
        self.next < self.end
    }

    /// Moves `next` on to the first occupied bin among those already looked up; `false` if there is none.
    #[inline]
    pub fn march_looked_up(&mut self) -> bool {
        let found = self.window.left(self.next).filter(|&bin| bin < self.end);
        self.next = found.unwrap_or(self.next);
        found.is_some()
    }
}

/// The occupancy grid, if that of `bins` is looked up in windows.
#[inline]
fn windows<'p>(isa: Isa, plan: &'p Plan<'_>, bins: &Bins) -> Option<&'p OccupancyGrid<'p>> {
    let middles = plan.effects.jitter.is_none() && bins.count() <= window::MAX_BINS;
    plan.occupancy.as_ref().filter(|_| VECTORS && isa != Isa::Portable && middles)
}

/// The rays whose next sample is occupied, each at most once: a queue in a ring buffer.
pub(super) struct ActiveRays<'w> {
    ring: &'w mut [u32],
    first: usize,
    count: usize,
}

impl<'w> ActiveRays<'w> {
    /// An empty queue; `ring` has room for every ray.
    pub fn new(ring: &'w mut [u32]) -> Self {
        Self { ring, first: 0, count: 0 }
    }

    pub fn len(&self) -> usize {
        self.count
    }

    pub fn push(&mut self, ray: u32) {
        let (capacity, end) = (self.ring.len(), self.first + self.count);
        put(self.ring, if end < capacity { end } else { end - capacity }, ray);
        self.count += 1;
    }

    pub fn pop(&mut self) -> Option<u32> {
        self.count = self.count.checked_sub(1)?;
        let ray = at(self.ring, self.first);
        self.first = if self.first + 1 < self.ring.len() { self.first + 1 } else { 0 };
        Some(ray)
    }
}

/// The block that goes through trunk and density head: `[samples]` each.
pub(super) struct Block<'w> {
    /// The index of each sample's ray, and its distance along that; the samples of a ray are neighbours, in order.
    pub owner: &'w mut [u32],
    pub t: &'w mut [f32],
    pub sigma: &'w mut [f32],
}

/// The samples of a block whose colour or normal is evaluated, in order: `[samples]` each, or empty where the request
/// has neither.
pub(super) struct Picks<'w> {
    pub column: &'w mut [u32],
    pub owner: &'w mut [u32],
    pub weight: &'w mut [f32],
}

/// The picks of several blocks, compacted into a block of their own: `[samples]` each, or empty where a block is one
/// sample.
pub(super) struct ColourQueue<'w> {
    /// The trunk's outputs, `[activation_rows][samples]`: the colour branch overwrites them.
    pub h: &'w mut [f32],
    pub owner: &'w mut [u32],
    pub weight: &'w mut [f32],
    pub count: usize,
}

impl Frame<'_, '_> {
    /// [`RayState::march`] of the tile's rays `list`.
    pub(super) fn march_all(&mut self, list: &[u32]) {
        let (plan, isa) = (self.plan, self.network.isa());
        if let Some(occupancy) = windows(isa, plan, &plan.bins) {
            let (contraction, bins) = (plan.contraction.as_ref(), &plan.bins);
            let (rays, inner) = (&mut *self.rays, self.inner);
            return isa.run(MarchAll { occupancy, contraction, bins, rays, list, inner });
        }
        for &ray in list {
            if let Some(state) = self.rays.get_mut(ray as usize) {
                state.march(isa, plan, &plan.bins, state.place(plan, self.turn));
            }
        }
    }

    /// Evaluates one block of samples; `false` if no ray is active.
    pub(super) fn step<M: Math, const COLLIDE: bool>(&mut self) -> bool {
        let n = self.fill::<COLLIDE>();
        if n == 0 {
            return false;
        }
        self.evaluate_density(n);
        let (used, picked) = self.gather::<M, COLLIDE>(n);
        self.counters.add_density(self.network, used);
        if self.deferred.is_on() {
            self.deferred.add(self.network, &self.scratch, &self.picks, picked);
        } else if self.plan.outputs.rgb {
            if picked * QUEUED_BELOW.1 >= self.block.owner.len() * QUEUED_BELOW.0 {
                self.flush_colour();
                self.colour_of_block(n, picked);
            } else {
                self.queue_colour(picked);
            }
        }
        self.queue_normals(picked);
        true
    }

    /// Fills a block with the next sample of each active ray, or with several of each: a vector's columns where there are
    /// fewer rays, and without a transmittance threshold all samples of as many rays as fit. Returns the number of samples.
    fn fill<const COLLIDE: bool>(&mut self) -> usize {
        let (plan, isa) = (self.plan, self.network.isa());
        let room = self.block.owner.len();
        let burst = match columns_of(self.network, 1) {
            _ if plan.transmittance_cut == 0.0 && !COLLIDE => room,
            columns => (columns / self.active.count.max(1)).max(1),
        };
        let mut n = 0;
        while n < room {
            let Some(i) = self.active.pop() else { break };
            let Some(state) = self.rays.get_mut(i as usize) else { break };
            for taken in 0..burst.min(room - n) {
                let place = state.place(plan, self.turn);
                // The next sample of an active ray is occupied.
                if taken > 0 && !self.drawn.march(isa, plan, i, state, place) {
                    break;
                }
                let t = self.drawn.take(plan, i, state, place, n);
                put(self.block.owner, n, i);
                put(self.block.t, n, t);
                state.next += 1;
                n += 1;
            }
        }
        self.put_positions(n);
        n
    }

    /// Puts the positions of the block's `n` samples where the network takes them.
    pub(super) fn put_positions(&mut self, n: usize) {
        let stride = columns_of(self.network, n);
        if VECTORS && let Some(contraction) = &self.plan.contraction {
            for column in 0..n {
                let ray = at(self.rays, at(self.block.owner, column) as usize).ray;
                put_column(self.positions, stride, column, ray.origin.to_array());
                put_column(self.triples, stride, column, ray.dir.to_array());
            }
            fill_up(self.positions, 3, stride, n);
            fill_up(self.triples, 3, stride, n);
            fill_up(self.block.t, 1, stride, n);
            let (positions, dirs, t) = (&mut *self.positions, &*self.triples, &*self.block.t);
            let points = ContractPoints { contraction, stride, dir_stride: stride, positions, dirs, t };
            self.network.isa().run_columns(stride, points);
            return;
        }
        for column in 0..n {
            let Some(state) = self.rays.get(at(self.block.owner, column) as usize) else { break };
            let p = self.plan.point(&state.ray, at(self.block.t, column));
            put_column(self.positions, stride, column, p.to_array());
        }
        fill_up(self.positions, 3, stride, n);
    }

    /// Composites the densities of the block's `n` samples, picks those whose colour or normal is evaluated, and marches
    /// the rays that go on to their next occupied sample. Returns how many of the samples lie before the end of their ray,
    /// and how many were picked.
    fn gather<M: Math, const COLLIDE: bool>(&mut self, n: usize) -> (usize, usize) {
        let (plan, isa) = (self.plan, self.network.isa());
        // Without vectors it would be the same work in more code.
        if VECTORS {
            self.absorb::<M, COLLIDE>(n);
        }
        let (mut used, mut picked) = (0, 0);
        for column in 0..n {
            let owner = at(self.block.owner, column);
            let Some(state) = self.rays.get_mut(owner as usize) else { break };
            if state.done {
                continue;
            }
            state.kept += 1;
            used += 1;
            let sigma = at(self.block.sigma, column);
            if sigma.is_nan() {
                self.counters.invalid_samples += 1;
            } else if sigma > 0.0 {
                let (before, t, middle, delta);
                if VECTORS {
                    let room = self.block.owner.len();
                    [t, middle, delta] = self::column(self.positions, room, column);
                    let (alpha, light);
                    [before, alpha, light] = self::column(self.triples, room, column);
                    if !COLLIDE {
                        state.gathered.add_alpha(alpha, light, t);
                    }
                } else {
                    (t, middle, delta) =
                        part(plan, &self.drawn, state, owner, at(self.block.t, column), column);
                    before = state.gathered.optical_thickness();
                    if COLLIDE {
                        state.gathered.add_thickness(thickness(sigma, delta));
                    } else {
                        state.gathered.add_density::<M>(sigma, t, delta);
                    }
                }
                let weight = if COLLIDE {
                    state.done = state.gathered.collide(before, sigma, middle, delta);
                    state.done.then_some(1.0)
                } else {
                    self.medians.look(owner, before, &state.gathered, sigma, middle, delta);
                    state.done = state.gathered.transmittance() < plan.transmittance_cut;
                    if plan.outputs.picks() { state.gathered.take_uncoloured(plan.colour_cut) } else { None }
                };
                if plan.outputs.picks()
                    && let Some(weight) = weight
                {
                    put(self.picks.column, picked, column as u32);
                    put(self.picks.owner, picked, owner);
                    put(self.picks.weight, picked, weight);
                    picked += 1;
                }
            }
            let last = column + 1 == n || at(self.block.owner, column + 1) != owner;
            if last && !state.done {
                let place = state.place(plan, self.turn);
                if self.drawn.march(isa, plan, owner, state, place) {
                    self.active.push(owner);
                }
            }
        }
        (used, picked)
    }

    /// Adds the optical thickness of the block's `n` samples to their rays, and works out what each keeps of the light.
    ///
    /// The exponentials are the same bits with every instruction set, sixteen at a time where there are so many.
    fn absorb<M: Math, const COLLIDE: bool>(&mut self, n: usize) {
        let isa = self.network.isa();
        let room = self.block.owner.len();
        if let Some(contraction) = &self.plan.contraction {
            self.parts_in_world(contraction, n);
        }
        for column in 0..n {
            let owner = at(self.block.owner, column);
            let Some(state) = self.rays.get_mut(owner as usize) else { break };
            let sigma = at(self.block.sigma, column);
            let before = if Medians::BUILT || COLLIDE { state.gathered.optical_thickness() } else { 0.0 };
            let mut tau = 0.0;
            if sigma > 0.0 {
                let delta;
                if self.plan.contraction.is_some() {
                    [_, _, delta] = self::column(self.positions, room, column);
                } else {
                    let (t, middle);
                    (t, middle, delta) =
                        part(self.plan, &self.drawn, state, owner, at(self.block.t, column), column);
                    if Medians::BUILT || COLLIDE {
                        put_column(self.positions, room, column, [t, middle, delta]);
                    } else {
                        put(self.positions, column, t);
                    }
                }
                tau = thickness(sigma, delta);
            }
            put_column(self.triples, room, column, [before, tau, state.gathered.add_thickness(tau)]);
        }
        // Portable lanes, of which there are as many with every instruction set.
        let columns = columns_of(self.network, n).next_multiple_of(MAX_LANES).min(room);
        if let Some((alpha, light)) = tail_mut(self.triples, room).split_at_mut_checked(room) {
            let (alpha, light) = (head_mut(alpha, columns), head_mut(light, columns));
            isa.run_portable(columns, Absorb::<M> { alpha, light, math: PhantomData });
        }
    }

    /// Puts where each of the block's `n` samples counts as, the middle of its bin and its width into the positions, world
    /// units along the ray: [`Plan::part_around`] of a block.
    fn parts_in_world(&mut self, contraction: &Contraction, n: usize) {
        let (room, plan) = (self.block.owner.len(), self.plan);
        let columns = columns_of(self.network, n);
        for column in 0..columns {
            let from = column.min(n.saturating_sub(1));
            let state = at(self.rays, at(self.block.owner, from) as usize);
            let (t, start, end) = plan.bins.with(state.ends).ends_around(at(self.block.t, from));
            put_column(self.positions, room, column, [t, start, end]);
            put(self.triples, column, plan.near.max(state.range[0]) - state.start);
        }
        let (parts, near) = (&mut *self.positions, &*self.triples);
        self.network.isa().run_columns(columns, PartsInWorld { contraction, room, columns, parts, near });
    }

    /// Sends the block's `n` samples through the colour branch from where they lie, and takes those that were picked.
    fn colour_of_block(&mut self, n: usize, picked: usize) {
        let owner = head(self.block.owner, n);
        self.shares.colour(self.network, self.plan, &mut self.scratch, owner, self.rgb);
        self.counters.add_colour(self.network, picked);
        let stride = self.scratch.stride;
        for i in 0..picked {
            let (owner, weight) = (at(self.picks.owner, i), at(self.picks.weight, i));
            let colour = column(self.rgb, stride, at(self.picks.column, i) as usize);
            add_colour(self.rays, owner, weight, colour, &mut self.counters);
        }
    }

    /// Puts the block's picks into the colour queue, and that through the colour branch whenever it is full.
    fn queue_colour(&mut self, picked: usize) {
        let (room, stride) = (self.queue.owner.len(), self.scratch.stride);
        let mut from = 0;
        while from < picked {
            let start = self.queue.count;
            let to = picked.min(from + room - start);
            let count = to - from;
            copy(tail_mut(self.queue.owner, start), head(tail(self.picks.owner, from), count));
            copy(tail_mut(self.queue.weight, start), head(tail(self.picks.weight, from), count));
            let columns = head(tail(self.picks.column, from), count);
            let from_rows = self.scratch.front.chunks_exact(stride.max(1));
            let rows = from_rows.zip(self.queue.h.chunks_exact_mut(room.max(1)));
            for (h, queued) in rows.take(self.network.trunk_rows()) {
                for (queued, &column) in tail_mut(queued, start).iter_mut().zip(columns) {
                    *queued = at(h, column as usize);
                }
            }
            self.queue.count = start + count;
            if self.queue.count == room {
                self.flush_colour();
            }
            from = to;
        }
    }

    /// Sends the colour queue through the colour branch; the block's `h` stays as it is.
    pub(super) fn flush_colour(&mut self) {
        let n = core::mem::take(&mut self.queue.count);
        if n == 0 {
            return;
        }
        let (room, stride) = (self.queue.owner.len(), columns_of(self.network, n));
        if stride < room {
            for row in 1..self.network.trunk_rows() {
                for column in 0..n {
                    let value = at(self.queue.h, row * room + column);
                    put(self.queue.h, row * stride + column, value);
                }
            }
        }
        let mut scratch = Scratch {
            stride,
            encoded: &mut *self.scratch.encoded,
            front: &mut *self.queue.h,
            back: &mut *self.scratch.back,
        };
        let (owner, weight) = (head(self.queue.owner, n), head(self.queue.weight, n));
        self.shares.colour(self.network, self.plan, &mut scratch, owner, self.rgb);
        self.counters.add_colour(self.network, n);
        for (i, (&owner, &weight)) in owner.iter().zip(weight).enumerate() {
            add_colour(self.rays, owner, weight, column(self.rgb, stride, i), &mut self.counters);
        }
    }
}

/// Of the bin that a ray's sample at `t` stands for, world units: where it counts as, its middle and its width.
#[inline]
fn part(
    plan: &Plan<'_>,
    drawn: &ProposalSamples<'_, '_>,
    state: &RayState,
    owner: u32,
    t: f32,
    column: usize,
) -> (f32, f32, f32) {
    if let Some((middle, delta)) = drawn.interval(plan, owner, column, state.range) {
        return (t.max(state.range[0]).min(state.range[1]), middle, delta);
    }
    let bins = plan.bins.with(state.ends);
    // A jittered sample lies anywhere in its bin, which stays where it is.
    let jittered = plan.outputs.median_distance && plan.effects.jitter.is_some();
    let (t, middle, delta) = plan.part_around(&bins, state.start, state.range[0], t);
    let whole = || if jittered { bins.middle_around(t) } else { t };
    (t, middle.unwrap_or_else(whole), delta)
}

/// From optical thickness to [`alpha`], and from its sum to [`light`].
struct Absorb<'a, M> {
    alpha: &'a mut [f32],
    light: &'a mut [f32],
    math: PhantomData<M>,
}

impl<M: Math> Op for Absorb<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        for (a, l) in self.alpha.chunks_exact_mut(V::COUNT).zip(self.light.chunks_exact_mut(V::COUNT)) {
            alpha::<M, V>(V::load(a)).store(a);
            light::<M, V>(V::load(l)).store(l);
        }
    }
}

/// From origins to the points at `t` of an unbounded scene's steps, contracted: `[3][stride]`.
pub(super) struct ContractPoints<'a> {
    pub contraction: &'a Contraction,
    pub stride: usize,
    /// Of the directions.
    pub dir_stride: usize,
    pub positions: &'a mut [f32],
    pub dirs: &'a [f32],
    pub t: &'a [f32],
}

impl Op for ContractPoints<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { contraction, stride, dir_stride, positions, dirs, t } = self;
        for from in (0..stride).step_by(V::COUNT) {
            let distance: V = contraction.distance_lanes(V::load(tail(t, from)));
            let mut p = [distance; 3];
            for (axis, p) in p.iter_mut().enumerate() {
                let (origin, dir) =
                    (tail(positions, axis * stride + from), tail(dirs, axis * dir_stride + from));
                *p = V::load(origin).add(V::load(dir).mul(distance));
            }
            let p = contraction.contract_lanes(p);
            for (axis, p) in p.into_iter().enumerate() {
                p.store(tail_mut(positions, axis * stride + from));
            }
        }
    }
}

/// From where samples and the ends of their bins are, in steps, to [`Plan::part_around`]: `[3][room]`.
pub(super) struct PartsInWorld<'a> {
    pub contraction: &'a Contraction,
    pub room: usize,
    pub columns: usize,
    pub parts: &'a mut [f32],
    pub near: &'a [f32],
}

impl Op for PartsInWorld<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let Self { contraction, room, columns, parts, near } = self;
        for at in (0..columns).step_by(V::COUNT) {
            let near = V::load(tail(near, at));
            let [t, from, to] = [0, room, 2 * room].map(|row| V::load(tail(parts, row + at)));
            let from = contraction.distance_lanes(from).max_of(near);
            let to = contraction.distance_lanes(to).max_of(from);
            let (t, width) = (contraction.distance_lanes(t).max_of(near), to.sub(from));
            t.store(tail_mut(parts, at));
            from.add(V::splat(0.5).mul(width)).store(tail_mut(parts, room + at));
            width.store(tail_mut(parts, 2 * room + at));
        }
    }
}

/// Adds a sample's colour to its ray.
#[inline]
fn add_colour(rays: &mut [RayState], owner: u32, weight: f32, mut colour: [f32; 3], counters: &mut Counters) {
    if colour.iter().any(|c| c.is_nan()) {
        counters.invalid_samples += 1;
        colour = [0.0; 3];
    }
    if let Some(state) = rays.get_mut(owner as usize) {
        state.gathered.add_colour(weight, colour);
    }
}

/// Copies all of `from` to the front of `to`.
fn copy<T: Copy>(to: &mut [T], from: &[T]) {
    debug_assert!(from.len() <= to.len(), "expected room for {} values, found {}", from.len(), to.len());
    to.iter_mut().zip(from).for_each(|(to, &from)| *to = from);
}
