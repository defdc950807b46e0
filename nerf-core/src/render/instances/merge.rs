//! Rays through several fields: the bins of all of them cut a ray into pieces in which every density is constant.
//!
//! A ray goes from piece to piece. Densities add there, and colours are mixed by density. Where the next bin of a field
//! begins, the ray waits until that field's network has been asked; rays that wait for the same one make a block. So a
//! field behind another is asked only where light gets to it.

use super::Instance;
use super::deferred::Deferred;
use crate::camera::{Camera, Ray};
use crate::math::Math;
use crate::memory::{Layout, at, column, head, put, put_column};
use crate::network::{GradientScratch, Network, Scratch};
use crate::plan::Plan;
use crate::render::anti_aliasing::{self, Sums};
use crate::render::deferred::is_deferred;
use crate::render::directions::DirectionShares;
use crate::render::frame::{block_samples, columns_of};
use crate::render::march::RayState;
use crate::render::source::{CameraRays, OwnRays, RaySource};
use crate::render::surface::Medians;
use crate::render::{Counters, Limit, RaySegment, Rect, Target, tone};
use crate::volume::{Accumulator, NormalSum, thickness};
use glam::Vec3;

/// A density beyond which nothing is seen at any width of a bin; sums of it stay finite.
const WALL: f32 = 1e30;

/// The part of a field that a ray is in, or comes to next: one bin.
#[derive(Clone, Copy)]
struct Part {
    known: Known,
    /// The sample of the bin, as the field's plan counts it.
    t: f32,
    /// World units along the ray, from [`Front::start`].
    from: f32,
    to: f32,
    /// Where in there its sample counts as.
    counts_at: f32,
    /// 1/world unit.
    sigma: f32,
    rgb: Option<[f32; 3]>,
    /// Whether its `h` waits in [`Deferred`].
    deferred: bool,
    /// Of the density, in the world's directions.
    gradient: Vec3,
}

/// What is known of a part.
#[derive(Clone, Copy, PartialEq)]
enum Known {
    /// The ray has left the field.
    Nothing,
    /// Where it is.
    Place,
    /// What is there.
    Sample,
}

impl Part {
    const NONE: Self = Self {
        known: Known::Nothing,
        t: 0.0,
        from: 0.0,
        to: 0.0,
        counts_at: 0.0,
        sigma: 0.0,
        rgb: None,
        deferred: false,
        gradient: Vec3::ZERO,
    };
}

/// A ray in the world.
#[derive(Clone, Copy)]
struct Front {
    ray: Ray,
    range: [f32; 2],
    x: u32,
    y: u32,
    /// Distances are counted from here, world units along the ray: where it comes to the first field.
    start: f32,
    /// How far it is.
    at: f32,
    /// The field it waits for.
    waits_for: Option<u32>,
    done: bool,
    gathered: Accumulator,
}

impl Default for Front {
    fn default() -> Self {
        Self::NONE
    }
}

impl Front {
    const NONE: Self = Self {
        ray: RayState::NONE.ray,
        range: [0.0; 2],
        x: 0,
        y: 0,
        start: 0.0,
        at: 0.0,
        waits_for: None,
        done: true,
        gathered: Accumulator::NONE,
    };
}

/// What a worker of several fields works with.
pub(in crate::render) struct Merge<'f, 'w> {
    instances: &'f [Instance<'f>],
    /// The last one's plan: what is not one field's business.
    pub plan: &'f Plan<'f>,
    /// `[instances][batch]` each: a ray where each field has it, and its next bin.
    rays: &'w mut [RayState],
    parts: &'w mut [Part],
    /// `[batch]` each.
    fronts: &'w mut [Front],
    medians: Medians<'w>,
    normals: &'w mut [NormalSum],
    /// `[instances]` of [`DirectionShares`] of their own length, side by side.
    shares: &'w mut [f32],
    deferred: Deferred<'f, 'w>,
    /// Rays of the block's samples, and of those whose colour is evaluated; their densities: `[samples]` each.
    owner: &'w mut [u32],
    picked: &'w mut [u32],
    sigma: &'w mut [f32],
    /// `[3][samples]` each.
    positions: &'w mut [f32],
    triples: &'w mut [f32],
    rgb: &'w mut [f32],
    gradient: &'w mut [f32],
    /// Of the largest of the networks.
    scratch: Scratch<'w>,
    way_back: GradientScratch<'w>,
    pub counters: Counters,
    sums: Sums<'w>,
    turn: u32,
    tile: Rect,
    /// Whether colour is over the background.
    pub background: bool,
    forward: Vec3,
}

impl<'f, 'w> Merge<'f, 'w> {
    /// All memory of a worker of `instances`, whose networks are `networks` and whose last has the plan `plan`: measured
    /// and carved by this list alone.
    pub fn lay_out<'n>(
        layout: &mut impl Layout<'w>,
        instances: &'f [Instance<'f>],
        networks: impl Iterator<Item = &'n Network<'n>> + Clone,
        plan: &'f Plan<'f>,
    ) -> Self {
        let networks = || networks.clone();
        let most = |rows: &dyn Fn(&Network<'n>) -> usize| networks().map(rows).max().unwrap_or(0);
        let samples = networks().map(|network| block_samples(network, plan)).max();
        let (rays, samples) = (plan.batch.rays, samples.unwrap_or(1));
        let each = rays.saturating_mul(networks().count());
        let outputs = plan.outputs;
        let colours = if outputs.rgb { samples } else { 0 };
        let (normals, gradients) = if outputs.normals { (rays, samples) } else { (0, 0) };
        let shares = networks().map(|network| shares_of(network, plan, samples)).sum();
        Self {
            instances,
            plan,
            rays: layout.slice(each, RayState::NONE),
            parts: layout.slice(each, Part::NONE),
            fronts: layout.slice(rays, Front::NONE),
            medians: Medians::lay_out(layout, plan),
            normals: layout.slice(normals, NormalSum::NONE),
            shares: layout.slice(shares, 0.0),
            deferred: Deferred::lay_out(layout, instances, networks(), plan, samples),
            owner: layout.slice(samples, 0),
            picked: layout.slice(samples, 0),
            sigma: layout.slice(samples, 0.0),
            positions: layout.slice(3 * samples, 0.0),
            triples: layout.slice(3 * samples, 0.0),
            rgb: layout.slice(3 * colours, 0.0),
            gradient: layout.slice(3 * gradients, 0.0),
            scratch: Scratch {
                stride: samples,
                encoded: layout.slice(most(&|network| network.encoded_rows()) * samples, 0.0),
                front: layout.slice(most(&|network| network.activation_rows()) * samples, 0.0),
                back: layout.slice(most(&|network| network.activation_rows()) * samples, 0.0),
            },
            way_back: GradientScratch {
                signs: layout.slice(most(&|network| network.sign_words(gradients)), 0),
                encoded: layout.slice(most(&|network| network.gradient_rows()) * gradients, 0.0),
            },
            counters: Counters::default(),
            sums: Sums::lay_out(layout, &plan.effects, outputs.surface(), rays),
            turn: 0,
            tile: Rect { x: 0, y: 0, width: 0, height: 0 },
            background: true,
            forward: Vec3::ZERO,
        }
    }

    /// Renders one tile of at most `plan.batch.rays` pixels, a ray of every pixel at a time.
    pub fn tile<M: Math>(
        &mut self,
        camera: &Camera,
        tile: Rect,
        limit: &impl Fn(u32, u32) -> Limit,
        target: &mut impl Target,
    ) {
        let far = far_from(self.instances, camera.pose().position);
        (self.tile, self.forward) = (tile, camera.pose().forward());
        for turn in 0..anti_aliasing::rays(&self.plan.effects) {
            self.turn = turn;
            let source = CameraRays::new(camera, &self.plan.effects, turn, limit, far);
            self.turn::<M, false>(&source, target);
        }
    }

    /// Renders up to `plan.batch.rays` rays from the `first` on as the pixels of a row; with `COLLIDE` each as far as its
    /// random number has it collide.
    pub fn row_of_rays<M: Math, const COLLIDE: bool>(
        &mut self,
        (first, count): (usize, usize),
        ray: &impl Fn(usize) -> RaySegment,
        random: &impl Fn(usize) -> f32,
        axis: Vec3,
        target: &mut impl Target,
    ) {
        let instances = self.instances;
        // Lossless: a plan has at most `Batch::MAX_RAYS`.
        self.tile = Rect { x: 0, y: 0, width: count as u32, height: 1 };
        (self.forward, self.turn) = (axis, 0);
        let far = |eye| far_from(instances, eye);
        self.turn::<M, COLLIDE>(&OwnRays { first, ray, random, far }, target);
    }

    fn turn<M: Math, const COLLIDE: bool>(&mut self, source: &impl RaySource, target: &mut impl Target) {
        let count = self.start::<COLLIDE>(source);
        for member in 0..self.instances.len() {
            self.directions(member, count);
        }
        for i in 0..count {
            self.advance::<M, COLLIDE>(i);
        }
        while self.round::<M, COLLIDE>(count) {}
        for member in 0..self.instances.len() {
            self.shade(member, count);
        }
        for i in 0..count {
            self.finish::<M>(i, source, target);
        }
    }

    /// Makes the tile's rays, and finds the first bin of each field on them. Returns how many they are.
    fn start<const COLLIDE: bool>(&mut self, source: &impl RaySource) -> usize {
        let (tile, capacity) = (self.tile, self.fronts.len());
        let mut count = 0;
        for y in tile.y..tile.y + tile.height {
            for x in tile.x..tile.x + tile.width {
                self.counters.rays += 1;
                let ray = source.ray(x, y);
                let range = source.range(x, y, &ray);
                let mut front = Front { ray, range, x, y, start: f32::INFINITY, done: false, ..Front::NONE };
                if COLLIDE {
                    front.gathered = Accumulator::until(source.until(x));
                }
                for (member, Instance { renderer, plan, placement }) in self.instances.iter().enumerate() {
                    let (ray, scale) = (placement.ray_in_field(&ray), placement.scale());
                    let range = plan.range_of(range[0] / scale, range[1] / scale);
                    let mut state = RayState { ray, range, x, y, ..RayState::NONE };
                    let around = if plan.occupancy.is_some() { renderer.occupied } else { Some(plan.bounds) };
                    if let Some(span) = around.and_then(|bounds| plan.span(&bounds, &ray, range)) {
                        (state.ray, state.start, state.ends) = (span.ray, span.start, span.ends);
                        (state.next, state.end) = (span.bins.start, span.bins.end);
                        front.start = front.start.min(scale * span.start);
                    }
                    put(self.rays, member * capacity + count, state);
                }
                if front.start == f32::INFINITY {
                    front.start = 0.0;
                }
                front.at = f32::NEG_INFINITY;
                put(self.fronts, count, front);
                self.medians.begin(count);
                self.deferred.begin(count);
                if let Some(sum) = self.normals.get_mut(count) {
                    *sum = NormalSum::NONE;
                }
                for member in 0..self.instances.len() {
                    self.next_part(member, count);
                }
                count += 1;
            }
        }
        count
    }

    /// Goes on to the next occupied bin of a field on ray `i`.
    fn next_part(&mut self, member: usize, i: usize) {
        let Some(Instance { renderer, plan, placement }) = self.instances.get(member) else { return };
        let place = member * self.fronts.len() + i;
        let Some((state, part)) = self.rays.get_mut(place).zip(self.parts.get_mut(place)) else { return };
        let jitter = state.place(plan, self.turn);
        if !state.march(renderer.network().isa(), plan, &plan.bins, jitter) {
            part.known = Known::Nothing;
            return;
        }
        let bins = plan.bins.with(state.ends);
        let t = jitter.t(&bins, state.next);
        let (counts_at, from, to) = plan.ends_around(&bins, state.start, state.range[0], t);
        let scale = placement.scale();
        let offset = scale * state.start - at(self.fronts, i).start;
        let [from, to, counts_at] = [from, to, counts_at].map(|t| offset + scale * t);
        *part = Part { known: Known::Place, t, from, to, counts_at, ..Part::NONE };
        state.next += 1;
    }

    /// The direction's share of a field's colour branch, for the first `count` rays.
    fn directions(&mut self, member: usize, count: usize) {
        let Some(Instance { renderer, plan, .. }) = self.instances.get(member) else { return };
        let (first, capacity) = (member * self.fronts.len(), self.fronts.len());
        let rays = self.rays.get(first..first + capacity).map_or(&[][..], |rays| head(rays, count));
        let parts = self.parts.get(first..first + count).unwrap_or(&[]);
        if !plan.outputs.rgb
            || self.deferred.is_on(member)
            || parts.iter().all(|part| part.known == Known::Nothing)
        {
            return;
        }
        let mut shares = shares_at(self.instances, self.plan, self.owner.len(), self.shares, member);
        shares.fill(renderer.network(), plan.math, &mut self.scratch, self.triples, rays);
        self.counters.macs += count as u64 * renderer.network().direction_macs() as u64;
    }

    /// Adds the colours that a field shaded once a ray has for the first `count` rays.
    fn shade(&mut self, member: usize, count: usize) {
        let first = member * self.fronts.len();
        if !self.deferred.is_on(member) {
            return;
        }
        let (fronts, scratch, counters) = (&mut *self.fronts, &mut self.scratch, &mut self.counters);
        let rays = self.rays.get_mut(first..first + count).unwrap_or_default();
        self.deferred.shade(member, scratch, rays, counters, |ray, weight, rgb| {
            if let Some(front) = fronts.get_mut(ray) {
                front.gathered.add_colour(weight, rgb);
            }
        });
    }

    /// Asks each field for the samples that rays wait for; `false` if none waits.
    fn round<M: Math, const COLLIDE: bool>(&mut self, count: usize) -> bool {
        let mut any = false;
        for member in 0..self.instances.len() {
            let mut next = 0;
            loop {
                let mut n = 0;
                while n < self.owner.len() && next < count {
                    if at(self.fronts, next).waits_for == Some(member as u32) {
                        put(self.owner, n, next as u32);
                        n += 1;
                    }
                    next += 1;
                }
                if n == 0 {
                    break;
                }
                any = true;
                self.ask::<COLLIDE>(member, n);
                for k in 0..n {
                    self.advance::<M, COLLIDE>(at(self.owner, k) as usize);
                }
            }
        }
        any
    }

    /// Asks a field for the next sample of the block's `n` rays.
    fn ask<const COLLIDE: bool>(&mut self, member: usize, n: usize) {
        let Some(Instance { renderer, plan, placement }) = self.instances.get(member) else { return };
        let (network, scale, first) = (renderer.network(), placement.scale(), member * self.fronts.len());
        let stride = columns_of(network, n);
        for column in 0..stride {
            // What only fills the block up is a copy of its last sample.
            let i = first + at(self.owner, column.min(n - 1)) as usize;
            let p = plan.point(&at(self.rays, i).ray, self.parts.get(i).map_or(0.0, |part| part.t));
            put_column(self.positions, stride, column, p.to_array());
        }
        self.scratch.stride = stride;
        network.trunk(plan.math, &mut self.scratch, self.positions);
        network.density(plan.math, &self.scratch, self.sigma);
        self.counters.add_density(network, n);
        let mut picked = 0;
        for k in 0..n {
            let ray = at(self.owner, k);
            let i = first + ray as usize;
            let Some((part, state)) = self.parts.get_mut(i).zip(self.rays.get_mut(i)) else { break };
            let Some(front) = self.fronts.get(ray as usize) else { break };
            let sigma = at(self.sigma, k) / scale;
            self.counters.invalid_samples += u64::from(sigma.is_nan());
            part.known = Known::Sample;
            part.sigma = if sigma > 0.0 { sigma.min(WALL) } else { 0.0 };
            state.kept += 1;
            // Other fields in there only take light from this one.
            let most = front.gathered.transmittance() * thickness(part.sigma, part.to - part.from).min(1.0);
            if part.sigma > 0.0 && plan.outputs.picks() && (COLLIDE || most > plan.colour_cut) {
                if self.deferred.is_on(member) {
                    part.deferred = true;
                    self.deferred.keep(member, ray as usize, &self.scratch, k);
                } else {
                    for row in 0..network.trunk_rows() {
                        let h = at(self.scratch.front, row * stride + k);
                        put(self.scratch.front, row * stride + picked, h);
                    }
                }
                let p: [f32; 3] = column(self.positions, stride, k);
                put_column(self.positions, stride, picked, p);
                put(self.picked, picked, ray);
                picked += 1;
            }
        }
        if picked > 0 && plan.outputs.rgb && !self.deferred.is_on(member) {
            self.colours(member, picked);
        }
        if picked > 0 && plan.outputs.normals {
            self.gradients(member, picked);
        }
    }

    /// Colours of the block's first `n` columns, whose trunk has just run.
    fn colours(&mut self, member: usize, n: usize) {
        let Some(Instance { renderer, plan, .. }) = self.instances.get(member) else { return };
        let owner = head(self.picked, n);
        let shares = shares_at(self.instances, self.plan, self.owner.len(), self.shares, member);
        shares.colour(renderer.network(), plan, &mut self.scratch, owner, self.rgb);
        self.counters.add_colour(renderer.network(), n);
        for (k, &ray) in owner.iter().enumerate() {
            let mut rgb: [f32; 3] = column(self.rgb, self.scratch.stride, k);
            if rgb.iter().any(|c| c.is_nan()) {
                self.counters.invalid_samples += 1;
                rgb = [0.0; 3];
            }
            if let Some(part) = self.parts.get_mut(member * self.fronts.len() + ray as usize) {
                part.rgb = Some(rgb);
            }
        }
    }

    /// Gradients at the block's first `n` positions.
    fn gradients(&mut self, member: usize, n: usize) {
        let Some(Instance { renderer, plan, placement }) = self.instances.get(member) else { return };
        let (network, from, stride) =
            (renderer.network(), self.scratch.stride, columns_of(renderer.network(), n));
        for k in 0..stride {
            let p: [f32; 3] = column(self.positions, from, k.min(n - 1));
            put_column(self.triples, stride, k, p);
        }
        self.scratch.stride = stride;
        let (scratch, way_back) = (&mut self.scratch, &mut self.way_back);
        network.gradient(plan.math, scratch, way_back, self.triples, plan.normal_deviation(), self.gradient);
        self.counters.add_normals(network, n);
        for (k, &ray) in head(self.picked, n).iter().enumerate() {
            let mut gradient = Vec3::from(column(self.gradient, stride, k));
            if let Some(contraction) = &plan.contraction {
                let p: [f32; 3] = column(self.triples, stride, k);
                gradient = contraction.gradient_in_world(p.into(), gradient);
            }
            self.counters.invalid_samples += u64::from(!gradient.is_finite());
            if let Some(part) = self.parts.get_mut(member * self.fronts.len() + ray as usize) {
                part.gradient = placement.dir_in_world(gradient);
            }
        }
    }

    /// Takes ray `i` on to where it has to wait, or to its end.
    fn advance<M: Math, const COLLIDE: bool>(&mut self, i: usize) {
        let (members, capacity) = (self.instances.len(), self.fronts.len());
        loop {
            let Some(front) = self.fronts.get_mut(i) else { return };
            front.waits_for = None;
            if front.done {
                return;
            }
            // The piece from here to where the first of the bins begins or ends.
            let (mut end, mut sigma, mut whole) = (f32::INFINITY, 0.0, None);
            for member in 0..members {
                let Some(part) = self.parts.get(member * capacity + i) else { return };
                match part.known {
                    Known::Nothing => {}
                    Known::Place if part.from <= front.at => {
                        front.waits_for = Some(member as u32);
                        return;
                    }
                    Known::Place => end = end.min(part.from),
                    Known::Sample => {
                        end = end.min(part.to);
                        // A bin that no other begins or ends in.
                        let alone = sigma == 0.0 && part.from == front.at;
                        whole = alone.then_some((part.counts_at, part.to));
                        sigma += part.sigma;
                    }
                }
            }
            if end == f32::INFINITY {
                return;
            }
            let from = front.at;
            front.at = from.max(end);
            if sigma > 0.0 && end > from {
                let counts_at = whole.filter(|(_, to)| *to == end).map(|(t, _)| t);
                self.composite::<M, COLLIDE>(i, [from, end], counts_at, sigma);
            }
            for member in 0..members {
                let part = self.parts.get(member * capacity + i);
                if part.is_some_and(|part| part.known == Known::Sample && part.to <= from.max(end)) {
                    self.next_part(member, i);
                }
            }
        }
    }

    /// Adds a piece of ray `i`, whose densities add up to `sigma`; `counts_at`: where it does, if not in its middle.
    fn composite<M: Math, const COLLIDE: bool>(
        &mut self,
        i: usize,
        [from, to]: [f32; 2],
        counts_at: Option<f32>,
        sigma: f32,
    ) {
        let Some(front) = self.fronts.get_mut(i) else { return };
        let (width, middle) = (to - from, from + 0.5 * (to - from));
        let before = front.gathered.optical_thickness();
        let weight = if COLLIDE {
            front.gathered.add_thickness(thickness(sigma, width));
            front.done = front.gathered.collide(before, sigma, middle, width);
            f32::from(u8::from(front.done))
        } else {
            let weight = front.gathered.add_density::<M>(sigma, counts_at.unwrap_or(middle), width);
            self.medians.look(i as u32, before, &front.gathered, sigma, middle, width);
            front.done = front.gathered.transmittance() < self.plan.transmittance_cut;
            weight
        };
        if weight == 0.0 {
            return;
        }
        let (mut rgb, mut coloured) = (Vec3::ZERO, 0.0);
        for member in 0..self.instances.len() {
            let Some(part) = self.parts.get(member * self.fronts.len() + i) else { return };
            if part.known != Known::Sample {
                continue;
            }
            let share = part.sigma / sigma;
            if let Some(own) = part.rgb {
                rgb += share * Vec3::from(own);
                coloured += share;
            }
            if part.deferred {
                coloured += share;
            }
            if let Some(sum) = self.normals.get_mut(i) {
                sum.add(weight * share, part.gradient);
            }
        }
        let Some(front) = self.fronts.get_mut(i) else { return };
        // What is too light to be asked for its colour takes that of the others here, or of what is behind.
        if coloured > 0.0
            && let Some(weight) = if COLLIDE { Some(weight) } else { front.gathered.take_uncoloured(0.0) }
        {
            front.gathered.add_colour(weight, (rgb / coloured).to_array());
            for member in 0..self.instances.len() {
                let part = self.parts.get(member * self.fronts.len() + i);
                if let Some(part) = part.filter(|part| part.known == Known::Sample && part.deferred) {
                    self.deferred.add(member, i, weight * (part.sigma / sigma) / coloured);
                }
            }
        }
    }

    /// The pixel of ray `i`.
    fn finish<M: Math>(&mut self, i: usize, source: &impl RaySource, target: &mut impl Target) {
        let (plan, tile, front) = (self.plan, self.tile, at(self.fronts, i));
        let far = source.far(front.x).min(front.range[1]);
        for (member, Instance { plan, .. }) in self.instances.iter().enumerate() {
            let kept = at(self.rays, member * self.fronts.len() + i).kept;
            self.counters.samples_skipped += u64::from(plan.samples_per_ray().saturating_sub(kept));
        }
        let shown = plan.outputs.rgb && self.background;
        let background =
            tone::background::<M>(&plan.effects.tone, if shown { plan.background } else { [0.0; 3] });
        let cosine = front.ray.dir.dot(self.forward);
        let mut seen = front.gathered.finish_from(front.start, front.done, background, far, cosine);
        seen.rgb = tone::to_light::<M>(&plan.effects.tone, seen.rgb);
        seen.median_distance = self.medians.finish(Some(i), plan, front.start, far);
        seen.normal = self.normals.get(i).map_or([0.0; 3], |sum| sum.finish(seen.opacity));
        let index = (front.y - tile.y) as usize * tile.width as usize + (front.x - tile.x) as usize;
        if let Some(mut pixel) = self.sums.add(&plan.effects, index, self.turn, seen, far) {
            pixel.rgb = tone::to_display::<M>(&plan.effects.tone, pixel.rgb);
            target.put(front.x, front.y, &pixel);
        }
    }

    /// Density and colour at up to one block of points.
    pub fn points(
        &mut self,
        positions: &[[f32; 3]],
        dirs: &[[f32; 3]],
        sigma: &mut [f32],
        rgb: &mut [[f32; 3]],
    ) {
        sigma.fill(0.0);
        rgb.fill([0.0; 3]);
        for (member, Instance { renderer, plan, placement }) in self.instances.iter().enumerate() {
            let (network, first) = (renderer.network(), member * self.fronts.len());
            let mut n = 0;
            for (i, (&p, &dir)) in positions.iter().zip(dirs).enumerate() {
                let origin = plan.inside(placement.point_in_field(p.into()));
                if plan.occupied(origin)
                    && let Some(place) = self.rays.get_mut(first + n)
                {
                    let dir = placement.dir_in_field(dir.into());
                    *place = RayState { ray: Ray { origin, dir }, x: i as u32, ..RayState::NONE };
                    put(self.picked, n, n as u32);
                    n += 1;
                }
            }
            if n == 0 {
                continue;
            }
            let coloured = plan.outputs.rgb && !rgb.is_empty();
            let stride = columns_of(network, n);
            let points = self.rays.get(first..first + n).unwrap_or(&[]);
            let deferred = self.deferred.is_on(member);
            if coloured && !deferred {
                let mut shares = shares_at(self.instances, self.plan, self.owner.len(), self.shares, member);
                shares.fill(network, plan.math, &mut self.scratch, self.triples, points);
                self.counters.macs += n as u64 * network.direction_macs() as u64;
            }
            for column in 0..stride {
                let p = at(points, column.min(n - 1)).ray.origin;
                put_column(self.positions, stride, column, p.to_array());
            }
            self.scratch.stride = stride;
            network.trunk(plan.math, &mut self.scratch, self.positions);
            network.density(plan.math, &self.scratch, self.sigma);
            self.counters.add_density(network, n);
            if coloured && deferred {
                let dir = |i: usize| at(points, i).ray.dir;
                let (networks, scratch) = (&mut self.deferred.networks, &mut self.scratch);
                networks.of_samples(network, plan, scratch, (n, dir), &mut self.counters);
            } else if coloured {
                let shares = shares_at(self.instances, self.plan, self.owner.len(), self.shares, member);
                shares.colour(network, plan, &mut self.scratch, head(self.picked, n), self.rgb);
                self.counters.add_colour(network, n);
            }
            for (k, state) in points.iter().enumerate() {
                let (i, density) = (state.x as usize, at(self.sigma, k) / placement.scale());
                let colours = if deferred { &*self.deferred.networks.rgb } else { &*self.rgb };
                let own: [f32; 3] = if coloured { column(colours, stride, k) } else { [0.0; 3] };
                let invalid = density.is_nan() || (density > 0.0 && own.iter().any(|c| c.is_nan()));
                self.counters.invalid_samples += u64::from(invalid);
                if density.is_nan() || density <= 0.0 {
                    continue;
                }
                let (density, before) = (density.min(WALL), at(sigma, i));
                put(sigma, i, before + density);
                if let Some(rgb) = rgb.get_mut(i) {
                    let own = if invalid { Vec3::ZERO } else { own.into() };
                    *rgb = Vec3::from(*rgb).lerp(own, density / (before + density)).to_array();
                }
            }
        }
    }
}

/// The distance of pixels without a surface, seen from `eye`: at least that of anything in any of the fields.
fn far_from(instances: &[Instance<'_>], eye: Vec3) -> f32 {
    let of = |it: &Instance<'_>| it.placement.scale() * it.plan.far_from(it.placement.point_in_field(eye));
    instances.iter().map(of).fold(0.0, f32::max)
}

/// Values of a network's [`DirectionShares`].
fn shares_of(network: &Network<'_>, plan: &Plan<'_>, samples: usize) -> usize {
    let at_samples = plan.outputs.rgb && !is_deferred(network, plan);
    let rows = if at_samples { network.direction_rows() } else { 0 };
    rows.saturating_mul(plan.batch.rays.div_ceil(samples.max(1)) * samples)
}

/// Those of one of the instances.
fn shares_at<'a>(
    instances: &[Instance<'_>],
    plan: &Plan<'_>,
    samples: usize,
    values: &'a mut [f32],
    member: usize,
) -> DirectionShares<'a> {
    let length = |it: &Instance<'_>| shares_of(it.renderer.network(), plan, samples);
    let first: usize = instances.iter().take(member).map(length).sum();
    let own = instances.get(member).map_or(0, length);
    let values = values.get_mut(first..first + own).unwrap_or_default();
    DirectionShares { values, block: samples }
}
