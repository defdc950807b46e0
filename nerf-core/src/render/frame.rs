//! The frame loop of one field: a tile's rays from pixel to pixel.

use super::Counters;
use super::field::Field;
use super::march::{Packets, Rays};
use super::pixel::{Pixels, RaySource, Surface, Target};
use super::stages::{
    Colour, ColumnMarch, Compositing, Deferred, Density, Normals, PointColour, Proposer, evaluate_points,
    propose, take_points,
};
use crate::math::Math;
use crate::memory::{Layout, head, head_mut, put};
use crate::space::SceneBox;
use glam::Vec3;

/// The stages of a field's frames.
pub(super) struct Frame<'f, 'w> {
    field: Field<'f>,
    proposer: &'f Proposer<'f>,
    rays: Rays<'f, 'w>,
    density: Density<'w>,
    columns: ColumnMarch<'w>,
    compositing: Compositing<'w>,
    colour: Colour<'w>,
    deferred: Deferred<'w>,
    normals: Normals<'w>,
    surface: Surface<'w>,
}

impl<'f, 'w> Frame<'f, 'w> {
    /// All memory of a frame except that of its pixels: this list alone both measures and allocates it.
    pub fn lay_out(
        layout: &mut impl Layout<'w>,
        field: Field<'f>,
        proposer: &'f Proposer<'f>,
        around: (Option<SceneBox>, Option<Packets<'f>>),
    ) -> Self {
        let (network, samples) = (field.network, field.block_samples());
        let (encoded, activations) = proposer.rows(field.plan);
        let encoded = network.encoded_rows().max(encoded);
        let activations = network.activation_rows().max(activations);
        Self {
            field,
            proposer,
            rays: Rays::lay_out(layout, field, around, proposer.row(field.plan)),
            density: Density::lay_out(layout, samples, encoded, activations),
            columns: ColumnMarch::lay_out(layout, field),
            compositing: Compositing::lay_out(layout, field),
            colour: Colour::lay_out(layout, field),
            deferred: Deferred::lay_out(layout, field),
            normals: Normals::lay_out(layout, field),
            surface: Surface::lay_out(layout, field.plan),
        }
    }

    /// The distance of pixels without a surface, by the position they are seen from.
    pub fn far(&self) -> impl Fn(Vec3) -> f32 + use<'f> {
        let plan = self.field.plan;
        move |eye| plan.far_from(eye)
    }

    /// Renders one ray of each pixel of the tile; with `COLLIDE` each ray ends at the collision that its random
    /// number draws.
    #[inline(never)]
    pub fn turn<M: Math, const COLLIDE: bool>(
        &mut self,
        pixels: &mut Pixels<'_, '_>,
        source: &impl RaySource,
        target: &mut impl Target,
    ) {
        let Self { field, rays, density, .. } = self;
        let mut hits = rays.start::<M, COLLIDE>(pixels, source, target);
        if rays.samples.is_on() {
            hits = propose::<M>(self.proposer, *field, hits, (rays, density), pixels, source, target);
        }
        let (field, counters) = (*field, &mut pixels.counters);
        self.surface.begin(hits);
        self.deferred.begin(hits);
        self.colour.directions(field, &mut density.scratch, head(rays.states, hits), counters);
        if !COLLIDE {
            self.columns.run::<M>(field, rays, density, &mut self.deferred, counters);
        }
        while self.step::<M, COLLIDE>(counters) {}
        let (rays, density) = (head_mut(self.rays.states, hits), &mut self.density);
        self.colour.flush(field, &mut density.scratch, rays, counters);
        self.normals.flush(field, density, rays, &mut self.surface, counters);
        self.deferred.shade(field, &mut density.scratch, rays, counters);
        for (i, state) in rays.iter().enumerate() {
            let skipped = field.plan.samples_per_ray().saturating_sub(state.kept);
            pixels.counters.samples_skipped += u64::from(skipped);
            pixels.finish::<M>(&state.pixel, Some((&self.surface, i)), source, target);
        }
    }

    /// Evaluates one block of samples; `false` if no ray is active.
    fn step<M: Math, const COLLIDE: bool>(&mut self, counters: &mut Counters) -> bool {
        let Self { field, rays, density, compositing, surface, .. } = self;
        let (field, room) = (*field, density.owner.len());
        let n = rays.take::<COLLIDE>(room, |column, ray, t| density.put(column, ray, t));
        if n == 0 {
            return false;
        }
        density.place(field, n, rays.states);
        density.evaluate(field, n);
        let (used, picked) =
            compositing.run::<M, COLLIDE>(field, n, density, rays, &mut surface.medians, counters);
        counters.add_density(field.network, used);
        if self.deferred.is_on() {
            self.deferred.add(field, density, compositing, picked);
        } else if field.plan.outputs.rgb {
            self.colour.run(field, density, compositing, (n, picked), rays.states, counters);
        }
        self.normals.queue(field, density, compositing, picked, (rays.states, surface), counters);
        true
    }

    /// Density and colour at up to one block of points.
    pub fn points(
        &mut self,
        positions: &[[f32; 3]],
        dirs: &[[f32; 3]],
        sigma: &mut [f32],
        rgb: &mut [[f32; 3]],
        counters: &mut Counters,
    ) {
        let Self { field, rays, density, colour, deferred, .. } = self;
        let (field, points) = (*field, positions.iter().zip(dirs));
        let n = take_points(field, points.map(|(&p, &dir)| (p.into(), dir.into())), rays.states);
        let colour = match field.plan.outputs.rgb && !rgb.is_empty() {
            false => PointColour::None,
            true if deferred.is_on() => PointColour::Rays(&mut deferred.networks),
            true => {
                let (shares, rgb) = colour.shares(field);
                PointColour::Samples(shares, rgb)
            }
        };
        evaluate_points(field, head(rays.states, n), density, colour, counters, |i, density, colour| {
            put(sigma, i, density);
            if let Some(rgb) = rgb.get_mut(i) {
                *rgb = colour;
            }
        });
    }
}
