//! Rays through several fields. The bin edges of all fields cut a ray into segments of constant density.
//!
//! A ray is composited segment by segment: densities add, and colours are averaged with densities as weights. When a
//! ray reaches the next bin of a field, the ray waits until the field's network is evaluated there. Samples of rays
//! that wait for the same network form a block. A ray ends when it is opaque, so that the fields behind are not
//! evaluated.
//!
//! This file is longer than 400 lines, since each step of a ray reads and writes the same [`Part`]s.

use super::Instance;
use super::deferred::Deferred;
use crate::memory::{Layout, at, column, head, put, put_column};
use crate::network::Network;
use crate::plan::{Plan, Span};
use crate::render::Counters;
use crate::render::field::Field;
use crate::render::march::RayState;
use crate::render::pixel::{PixelRay, Pixels, RaySource, Surface, Target};
use crate::render::stages::{Density, DirectionShares, Gradients, evaluate_points};
use crate::volume::{Accumulator, thickness};
use glam::Vec3;

/// Largest density of a sample, 1/world unit; higher densities are clamped. A bin of this density is opaque, and the
/// sum of several fields' densities stays finite.
const WALL: f32 = 1e30;

/// A ray's current bin in one field: the occupied bin that contains the ray's current distance, or if there is none,
/// the next occupied bin along the ray.
#[derive(Clone, Copy, Default)]
struct Part {
    known: Known,
    /// Distance of the bin's sample from the origin of [`Span::ray`], in the field's units. In an unbounded scene, `t`
    /// is instead the argument `s` of [`Contraction::distance`](crate::space::Contraction::distance).
    t: f32,
    /// Start of the bin, world units from the ray's start.
    from: f32,
    /// End of the bin, world units from the ray's start.
    to: f32,
    /// Distance that the sample contributes to the weighted mean `ray_distance`, world units from the ray's start.
    counts_at: f32,
    /// Density of the sample, 1/world unit.
    sigma: f32,
    rgb: Option<[f32; 3]>,
    /// Whether the sample's hidden features `h` are stored in [`Deferred`].
    deferred: bool,
    /// Gradient of the raw density with respect to position, world space.
    gradient: Vec3,
}

/// State of a [`Part`]: which of its values are known.
#[derive(Clone, Copy, Default, PartialEq)]
enum Known {
    /// No value: the ray meets no further occupied bin of the field.
    #[default]
    Nothing,
    /// The ends of the bin are known. The network has not been evaluated for the bin's sample.
    Place,
    /// The ends of the bin are known, and the network has been evaluated for the bin's sample.
    Sample,
}

/// A ray in world space. The ray's start is the point at distance `pixel.start` from the ray's origin. `pixel.start` is
/// the smallest [`Span::start`] of all fields, converted to world units.
#[derive(Clone, Copy)]
struct WorldRay {
    pixel: PixelRay,
    /// Distance up to which the ray has been composited, world units from the ray's start.
    at: f32,
    /// Index of the field that must be evaluated before compositing continues; `None` if the ray has ended.
    waits_for: Option<u32>,
}

impl WorldRay {
    const NONE: Self = Self { pixel: PixelRay::NONE, at: f32::NEG_INFINITY, waits_for: None };
}

/// State and memory for rendering several fields in one frame.
pub(in crate::render) struct Merge<'f, 'w> {
    instances: &'f [Instance<'f>],
    /// Index of the current ray among the rays of its pixel; equal for all pixels of the tile.
    turn: u32,
    /// State of each ray in the coordinates of each field: `[instances][rays]`.
    rays: &'w mut [RayState],
    /// Current or next bin of each field on each ray: `[instances][rays]`.
    parts: &'w mut [Part],
    world: &'w mut [WorldRay],
    surface: Surface<'w>,
    /// Contributions of ray directions to the colour branch ([`DirectionShares`]): one table `[rays][direction_rows]`
    /// for each instance. Instances may differ in `direction_rows`.
    shares: &'w mut [f32],
    deferred: Deferred<'w>,
    /// Buffers of a block of samples, large enough for the network of any instance.
    density: Density<'w>,
    /// Ray index of each sample of a block whose colour or gradient is evaluated: `[samples]`.
    picked: &'w mut [u32],
    /// Buffer `[3][samples]`: holds the directions of a block of rays, and later the colours of a block of samples.
    rgb: &'w mut [f32],
    gradients: Gradients<'w>,
}

impl<'f, 'w> Merge<'f, 'w> {
    /// Reserves the buffers for rendering `instances`, except those of [`Pixels`]. `layout`: measures or allocates
    /// memory. `networks`: the instances' networks. `plan`: the plan of the last instance.
    pub fn lay_out<'n>(
        layout: &mut impl Layout<'w>,
        instances: &'f [Instance<'f>],
        networks: impl Iterator<Item = &'n Network<'n>> + Clone,
        plan: &'f Plan<'f>,
    ) -> Self {
        let networks = || networks.clone();
        let fields = || networks().map(|network| Field { network, plan });
        let most = |rows: &dyn Fn(&Network<'n>) -> usize| networks().map(rows).max().unwrap_or(0);
        let samples = fields().map(|field| field.block_samples()).max().unwrap_or(1);
        let rays = plan.batch.rays;
        let each = rays.saturating_mul(networks().count());
        let shares = fields().map(|field| DirectionShares::values(field, samples)).sum();
        let (encoded, activations) =
            (most(&|network| network.encoded_rows()), most(&|network| network.activation_rows()));
        Self {
            instances,
            turn: 0,
            rays: layout.slice(each, RayState::NONE),
            parts: layout.slice(each, Part::default()),
            world: layout.slice(rays, WorldRay::NONE),
            surface: Surface::lay_out(layout, plan),
            shares: layout.slice(shares, 0.0),
            deferred: Deferred::lay_out(layout, fields(), samples),
            density: Density::lay_out(layout, samples, encoded, activations),
            picked: layout.slice(samples, 0),
            rgb: layout.slice(if plan.outputs.rgb { 3 * samples } else { 0 }, 0.0),
            gradients: Gradients::lay_out(layout, networks(), if plan.outputs.normals { samples } else { 0 }),
        }
    }

    /// Returns a function that takes the camera's position and returns the distance, world units, of pixels without a
    /// surface: the largest [`Plan::far_from`] of all fields, converted to world units.
    pub fn far(&self) -> impl Fn(Vec3) -> f32 + use<'f> {
        let instances = self.instances;
        move |eye| {
            let of =
                |it: &Instance<'_>| it.placement.scale() * it.plan.far_from(it.placement.point_in_field(eye));
            instances.iter().map(of).fold(0.0, f32::max)
        }
    }

    /// Renders the ray of index `pixels.turn` of each pixel of the tile. Passes each pixel to `target` after the
    /// pixel's last ray. `COLLIDE`: whether a ray ends at a random collision, where its optical thickness reaches
    /// [`RaySource::until`].
    pub fn turn<const COLLIDE: bool>(
        &mut self,
        pixels: &mut Pixels<'_, '_>,
        source: &dyn RaySource,
        target: &mut dyn Target,
    ) {
        let mut count = 0;
        self.turn = pixels.turn;
        for (x, y) in pixels.tile.pixels() {
            self.start::<COLLIDE>((x, y), count, source);
            count += 1;
        }
        let counters = &mut pixels.counters;
        counters.rays += count as u64;
        self.surface.begin(count);
        self.deferred.begin(count);
        for member in 0..self.instances.len() {
            self.directions(member, count, counters);
        }
        for i in 0..count {
            self.advance::<COLLIDE>(i);
        }
        while self.round::<COLLIDE>(count, counters) {}
        for member in 0..self.instances.len() {
            self.shade(member, count, counters);
        }
        for i in 0..count {
            for (member, Instance { plan, .. }) in self.instances.iter().enumerate() {
                let kept = at(self.rays, member * self.world.len() + i).kept;
                counters.samples_skipped += u64::from(plan.samples_per_ray().saturating_sub(kept));
            }
        }
        for (i, front) in self.world.iter().enumerate().take(count) {
            pixels.finish(&front.pixel, Some((&self.surface, i)), target);
        }
    }

    /// Starts ray `i`, of pixel `(x, y)`: finds each field's first occupied bin on the ray. `COLLIDE`: whether the
    /// ray ends at a random collision.
    fn start<const COLLIDE: bool>(&mut self, (x, y): (u32, u32), i: usize, source: &dyn RaySource) {
        let (capacity, ray) = (self.world.len(), source.ray(x, y));
        let range = source.range(x, y, &ray);
        let mut start = f32::INFINITY;
        for (member, Instance { renderer, plan, placement }) in self.instances.iter().enumerate() {
            let (ray, scale) = (placement.ray_in_field(&ray), placement.scale());
            let range = plan.range_of(range[0] / scale, range[1] / scale);
            let around = if plan.occupancy.is_some() { renderer.occupied.around } else { Some(plan.bounds) };
            let span = around.and_then(|bounds| Span::new(plan, &bounds, &ray, range));
            start = span.as_ref().map_or(start, |span| start.min(scale * span.start));
            if let Some(state) = self.rays.get_mut(member * capacity + i) {
                state.begin((x, y), ray, range, span);
            }
        }
        let start = if start == f32::INFINITY { 0.0 } else { start };
        let gathered = if COLLIDE { Accumulator::until(source.until(x)) } else { Accumulator::NONE };
        let range = [range[0], range[1].min(source.far(&ray))];
        let pixel = PixelRay { ray, start, range, x, y, done: false, gathered };
        put(self.world, i, WorldRay { pixel, ..WorldRay::NONE });
        for member in 0..self.instances.len() {
            self.next_part(member, i);
        }
    }

    /// Marches ray `i` to the next occupied bin of field `member`. Stores the bin in `parts`, or [`Known::Nothing`] if
    /// there is no such bin.
    fn next_part(&mut self, member: usize, i: usize) {
        let Some(Instance { renderer, plan, placement }) = self.instances.get(member) else { return };
        let place = member * self.world.len() + i;
        let Some((state, part)) = self.rays.get_mut(place).zip(self.parts.get_mut(place)) else { return };
        let Some(ray) = self.world.get(i) else { return };
        let jitter = state.pixel.jitter(plan, self.turn);
        if !state.march(renderer.network().isa(), plan, &plan.bins, jitter) {
            part.known = Known::Nothing;
            return;
        }
        let t = jitter.t(&plan.bins.with(state.ends), state.next);
        let PixelRay { start, range, .. } = state.pixel;
        let edges = plan.spacing().edges(state.ends.parts(), plan.least_distance(start, range[0]), t);
        let scale = placement.scale();
        let offset = scale * start - ray.pixel.start;
        let [counts_at, from, to] = edges.map(|t| offset + scale * t);
        *part = Part { known: Known::Place, t, from, to, counts_at, ..Part::default() };
        state.next += 1;
    }

    /// Evaluates the contributions of ray directions to the colour branch of field `member` ([`DirectionShares`]), for
    /// the first `count` rays.
    fn directions(&mut self, member: usize, count: usize, counters: &mut Counters) {
        let Some(it) = self.instances.get(member) else { return };
        let first = member * self.world.len();
        let parts = self.parts.get(first..first + count).unwrap_or_default();
        if parts.iter().any(|part| part.known != Known::Nothing) {
            let rays = self.rays.get(first..first + count).unwrap_or_default();
            let mut shares = shares_at(self.instances, self.density.owner.len(), self.shares, member);
            shares.fill(it.field(), &mut self.density.scratch, self.rgb, rays, counters);
        }
    }

    /// Adds the colour of field `member`, evaluated once per ray, to the rays `0..count`. Does nothing unless the
    /// field's shading is deferred.
    fn shade(&mut self, member: usize, count: usize, counters: &mut Counters) {
        let field = self.instances.get(member).map(|it| it.field());
        let Some(field) = field.filter(|field| field.shades_rays()) else { return };
        let first = member * self.world.len();
        let rays = self.rays.get_mut(first..first + count).unwrap_or_default();
        let (networks, sums) = self.deferred.sums_of(member, count);
        networks.shade(field, &mut self.density.scratch, sums, rays, counters, |_, ray, weight, rgb| {
            if let Some(ray) = self.world.get_mut(ray) {
                ray.pixel.gathered.add_colour(weight, rgb);
            }
        });
    }

    /// Evaluates and composites the samples that the first `count` rays wait for. Returns `false` if no ray waits.
    /// `COLLIDE`: as in [`Merge::turn`].
    fn round<const COLLIDE: bool>(&mut self, count: usize, counters: &mut Counters) -> bool {
        let mut any = false;
        for member in 0..self.instances.len() {
            let mut next = 0;
            loop {
                let mut n = 0;
                while n < self.density.owner.len() && next < count {
                    let waits = self.world.get(next).and_then(|ray| ray.waits_for) == Some(member as u32);
                    if waits && let Some(part) = self.parts.get(member * self.world.len() + next) {
                        self.density.put(n, next as u32, part.t);
                        n += 1;
                    }
                    next += 1;
                }
                if n == 0 {
                    break;
                }
                any = true;
                self.ask::<COLLIDE>(member, n, counters);
                for k in 0..n {
                    self.advance::<COLLIDE>(at(self.density.owner, k) as usize);
                }
            }
        }
        any
    }

    /// Evaluates field `member` at the `n` samples in `self.density`, one per ray. Stores the results in `parts`. Skips
    /// the colour and normal of a sample that has no density, and of a sample whose weight cannot exceed the colour
    /// cut. `COLLIDE`: whether rays end at random collisions; the colour cut is then ignored.
    fn ask<const COLLIDE: bool>(&mut self, member: usize, n: usize, counters: &mut Counters) {
        let Some(it) = self.instances.get(member) else { return };
        let (field, first, density) = (it.field(), member * self.world.len(), &mut self.density);
        density.place(field, n, self.rays.get(first..).unwrap_or_default());
        density.evaluate(field, n);
        counters.add_density(field.network, n);
        let (stride, mut picked) = (density.scratch.stride, 0);
        for k in 0..n {
            let ray = at(density.owner, k);
            let i = first + ray as usize;
            let Some((part, state)) = self.parts.get_mut(i).zip(self.rays.get_mut(i)) else { break };
            let Some(world) = self.world.get(ray as usize) else { break };
            let sigma = at(density.sigma, k) / it.placement.scale();
            counters.invalid_samples += u64::from(sigma.is_nan());
            part.known = Known::Sample;
            part.sigma = if sigma > 0.0 { sigma.min(WALL) } else { 0.0 };
            state.kept += 1;
            // `most`: upper bound of the sample's weight. Other fields at the same place can only reduce the weight.
            let light = world.pixel.gathered.transmittance();
            let most = light * thickness(part.sigma, part.to - part.from).min(1.0);
            if part.sigma > 0.0 && field.plan.outputs.picks() && (COLLIDE || most > field.plan.colour_cut) {
                if field.shades_rays() {
                    part.deferred = true;
                    let h = self.deferred.h_mut(member, ray as usize);
                    h.fill(0.0);
                    field.network.add_h(&density.scratch, k, 1.0, h);
                } else {
                    for row in 0..field.network.trunk_rows() {
                        let h = at(density.scratch.front, row * stride + k);
                        put(density.scratch.front, row * stride + picked, h);
                    }
                }
                let p: [f32; 3] = column(density.positions, stride, k);
                put_column(density.positions, stride, picked, p);
                put(self.picked, picked, ray);
                picked += 1;
            }
        }
        let (owner, parts) = (head(self.picked, picked), &mut *self.parts);
        let part = |k: usize| first + at(owner, k) as usize;
        if picked > 0 && field.shades_samples() {
            let shares = shares_at(self.instances, density.owner.len(), self.shares, member);
            shares.evaluate(field, &mut density.scratch, owner, self.rgb);
            counters.add_colour(field.network, picked);
            for k in 0..picked {
                let rgb = counters.or_black(column(self.rgb, stride, k));
                if let Some(part) = parts.get_mut(part(k)) {
                    part.rgb = Some(rgb);
                }
            }
        }
        if picked > 0 && field.plan.outputs.normals {
            self.gradients.run(field, density, picked, counters, |k, gradient| {
                if let Some(part) = parts.get_mut(part(k)) {
                    part.gradient = it.placement.dir_in_world(gradient);
                }
            });
        }
    }

    /// Composites ray `i` up to the next sample that must be evaluated, or to the ray's end. `COLLIDE`: as in
    /// [`Merge::turn`].
    fn advance<const COLLIDE: bool>(&mut self, i: usize) {
        let (members, capacity) = (self.instances.len(), self.world.len());
        loop {
            let Some(ray) = self.world.get_mut(i) else { return };
            ray.waits_for = None;
            if ray.pixel.done {
                return;
            }
            // The segment from the ray's current distance to the next start or end of a bin.
            let (mut end, mut sigma, mut whole) = (f32::INFINITY, 0.0, None);
            for member in 0..members {
                let Some(part) = self.parts.get(member * capacity + i) else { return };
                match part.known {
                    Known::Nothing => {}
                    Known::Place if part.from <= ray.at => {
                        ray.waits_for = Some(member as u32);
                        return;
                    }
                    Known::Place => end = end.min(part.from),
                    Known::Sample => {
                        end = end.min(part.to);
                        // `whole`: `counts_at` and end of the segment's only bin with density. `None` if the bin begins
                        // before the segment, or if several bins have density.
                        if part.sigma != 0.0 {
                            let alone = sigma == 0.0 && part.from == ray.at;
                            whole = alone.then_some((part.counts_at, part.to));
                            sigma += part.sigma;
                        }
                    }
                }
            }
            if end == f32::INFINITY {
                return;
            }
            let from = ray.at;
            ray.at = from.max(end);
            if sigma > 0.0 && end > from {
                let counts_at = whole.filter(|(_, to)| *to == end).map(|(t, _)| t);
                self.composite::<COLLIDE>(i, [from, end], counts_at, sigma);
            }
            for member in 0..members {
                let part = self.parts.get(member * capacity + i);
                if part.is_some_and(|part| part.known == Known::Sample && part.to <= from.max(end)) {
                    self.next_part(member, i);
                }
            }
        }
    }

    /// Composites the segment `from..to` of ray `i`, world units from the ray's start. `sigma`: sum of the fields'
    /// densities, 1/world unit. `counts_at`: distance that the segment contributes to the weighted mean `ray_distance`;
    /// `None` for the segment's middle. `COLLIDE`: as in [`Merge::turn`].
    fn composite<const COLLIDE: bool>(
        &mut self,
        i: usize,
        [from, to]: [f32; 2],
        counts_at: Option<f32>,
        sigma: f32,
    ) {
        let (instances, capacity) = (self.instances, self.world.len());
        let (Some(Instance { plan, .. }), Some(ray)) = (instances.last(), self.world.get_mut(i)) else {
            return;
        };
        let PixelRay { gathered, done, .. } = &mut ray.pixel;
        let (width, middle) = (to - from, from + 0.5 * (to - from));
        let before = gathered.optical_thickness();
        let weight = if COLLIDE {
            gathered.add_thickness(thickness(sigma, width));
            *done = gathered.collide(before, sigma, middle, width);
            f32::from(u8::from(*done))
        } else {
            let weight = gathered.add_density(plan.math, sigma, counts_at.unwrap_or(middle), width);
            if self.surface.medians.passes(i as u32, gathered) {
                self.surface.medians.put(i as u32, before, sigma, [middle, width]);
            }
            *done = gathered.transmittance() < plan.transmittance_cut;
            weight
        };
        if weight == 0.0 {
            return;
        }
        let parts = &*self.parts;
        let samples = || {
            let members = (0..instances.len()).map(|member| (member, parts.get(member * capacity + i)));
            members.filter_map(|(member, part)| Some((member, part.filter(|it| it.known == Known::Sample)?)))
        };
        let (mut rgb, mut coloured) = (Vec3::ZERO, 0.0);
        for (_, part) in samples() {
            let share = part.sigma / sigma;
            if let Some(own) = part.rgb {
                rgb += share * Vec3::from(own);
                coloured += share;
            }
            if part.deferred {
                coloured += share;
            }
            if let Some(sum) = self.surface.normals.get_mut(i) {
                sum.add(weight * share, part.gradient);
            }
        }
        // A sample has no colour if its weight cannot exceed the colour cut. Its weight then goes to the coloured
        // samples of the segment. If the segment has none, the weight goes to the next coloured segment.
        if coloured > 0.0
            && let Some(weight) = if COLLIDE { Some(weight) } else { gathered.take_uncoloured(0.0) }
        {
            gathered.add_colour(weight, (rgb / coloured).to_array());
            for (member, part) in samples().filter(|(_, part)| part.deferred) {
                self.deferred.add(member, i, weight * (part.sigma / sigma) / coloured);
            }
        }
    }

    /// Computes the sum of the fields' densities, and the mean colour weighted by density, at `points`: pairs of
    /// position and direction, at most one block of points. `sigma` and `rgb` must hold zeros; `rgb` may be empty.
    pub fn points(
        &mut self,
        points: impl Iterator<Item = (Vec3, Vec3)> + Clone,
        sigma: &mut [f32],
        rgb: &mut [[f32; 3]],
        counters: &mut Counters,
    ) {
        for (member, it) in self.instances.iter().enumerate() {
            let (field, placement) = (it.field(), &it.placement);
            let rays = self.rays.get_mut(member * self.world.len()..).unwrap_or_default();
            let points =
                points.clone().map(|(p, dir)| (placement.point_in_field(p), placement.dir_in_field(dir)));
            let shares = shares_at(self.instances, self.density.owner.len(), self.shares, member);
            let colours = (!rgb.is_empty()).then_some((shares, &mut *self.rgb, &mut self.deferred.networks));
            evaluate_points(field, points, rays, &mut self.density, colours, counters, |i, density, own| {
                let (density, before) = ((density / placement.scale()).min(WALL), at(sigma, i));
                if density > 0.0 {
                    put(sigma, i, before + density);
                    if let Some(rgb) = rgb.get_mut(i) {
                        *rgb = Vec3::from(*rgb).lerp(own.into(), density / (before + density)).to_array();
                    }
                }
            });
        }
    }
}

/// Returns the part of `values` that belongs to instance `member`. `values`: [`DirectionShares::values`] of all
/// instances, one instance after another. `samples`: number of samples per block.
fn shares_at<'a>(
    instances: &[Instance<'_>],
    samples: usize,
    values: &'a mut [f32],
    member: usize,
) -> DirectionShares<'a> {
    let length = |it: &Instance<'_>| DirectionShares::values(it.field(), samples);
    let first: usize = instances.iter().take(member).map(length).sum();
    let own = instances.get(member).map_or(0, length);
    let values = values.get_mut(first..first + own).unwrap_or_default();
    DirectionShares { values, block: samples }
}
