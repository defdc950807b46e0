//! Rendering of one tile in a frame of one field: the pixels' rays are started, samples are evaluated, and the pixels
//! are finished.

use super::Counters;
use super::field::Field;
use super::march::{Packets, Rays};
use super::pixel::{Pixels, RaySource, Surface, Target};
use super::stages::{
    Colour, ColumnMarch, Compositing, Deferred, Density, Normals, Proposer, TileState, evaluate_points,
    propose,
};
use crate::memory::{Layout, head, put};
use crate::space::SceneBox;
use glam::Vec3;

/// Rendering stages of one field, with their buffers, which all frames reuse.
pub(super) struct Frame<'f, 'w> {
    proposer: &'f Proposer<'f>,
    tile: TileState<'f, 'w>,
    columns: ColumnMarch<'w>,
    compositing: Compositing<'w>,
    colour: Colour<'w>,
    deferred: Deferred<'w>,
    normals: Normals<'w>,
}

impl<'f, 'w> Frame<'f, 'w> {
    /// Reserves the buffers of all stages, except those of [`Pixels`], in `layout`, which measures or allocates memory.
    /// `around`: two aids for skipping empty space. The first is the box around all occupied cells; `None` if no cell
    /// is occupied or there is no grid. The second tests a whole packet of neighbouring rays for occupied cells; `None`
    /// if frames do not use this test.
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
        let tile = TileState {
            field,
            rays: Rays::lay_out(layout, field, around, proposer.row(field.plan)),
            density: Density::lay_out(layout, samples, encoded, activations),
            surface: Surface::lay_out(layout, field.plan),
        };
        Self {
            proposer,
            tile,
            columns: ColumnMarch::lay_out(layout, field),
            compositing: Compositing::lay_out(layout, field),
            colour: Colour::lay_out(layout, field),
            deferred: Deferred::lay_out(layout, field),
            normals: Normals::lay_out(layout, field),
        }
    }

    /// Returns a function that takes the camera's position and returns the distance, world units, of pixels without a
    /// surface.
    pub fn far(&self) -> impl Fn(Vec3) -> f32 + use<'f> {
        let plan = self.tile.field.plan;
        move |eye| plan.far_from(eye)
    }

    /// Renders the ray of index `pixels.turn` of each pixel of the tile. Passes each pixel to `target` after the
    /// pixel's last ray. `COLLIDE`: whether a ray ends at a random collision, where its optical thickness reaches
    /// [`RaySource::until`].
    #[inline(never)]
    pub fn turn<const COLLIDE: bool>(
        &mut self,
        pixels: &mut Pixels<'_, '_>,
        source: &dyn RaySource,
        target: &mut dyn Target,
    ) {
        let tile = &mut self.tile;
        tile.rays.start::<COLLIDE>(pixels, source, target);
        if tile.rays.samples.is_on() {
            propose(self.proposer, tile, pixels, target);
        }
        let (field, counters, hits) = (tile.field, &mut pixels.counters, tile.rays.hits);
        tile.surface.begin(hits);
        self.deferred.begin(hits);
        let (mut shares, dirs) = self.colour.shares(field);
        shares.fill(field, &mut tile.density.scratch, dirs, head(tile.rays.states, hits), counters);
        if !COLLIDE {
            self.columns.run(tile, &mut self.deferred, counters);
        }
        while self.step::<COLLIDE>(counters) {}
        let tile = &mut self.tile;
        self.colour.flush(tile, counters);
        self.normals.flush(tile, counters);
        self.deferred.shade(tile, counters);
        for (i, state) in head(tile.rays.states, hits).iter().enumerate() {
            let skipped = field.plan.samples_per_ray().saturating_sub(state.kept);
            pixels.counters.samples_skipped += u64::from(skipped);
            pixels.finish(&state.pixel, Some((&tile.surface, i)), target);
        }
    }

    /// Evaluates and composites the next block of samples. Returns `false` if no ray is active. `COLLIDE`: as in
    /// [`Frame::turn`].
    fn step<const COLLIDE: bool>(&mut self, counters: &mut Counters) -> bool {
        let Self { tile, compositing, .. } = self;
        let TileState { field, rays, density, .. } = tile;
        let (field, room) = (*field, density.owner.len());
        let n = rays.take::<COLLIDE>(room, |column, ray, t| density.put(column, ray, t));
        if n == 0 {
            return false;
        }
        density.place(field, n, rays.states);
        density.evaluate(field, n);
        compositing.run::<COLLIDE>(tile, counters);
        if self.deferred.is_on() {
            self.deferred.add(tile, compositing);
        } else if field.plan.outputs.rgb {
            self.colour.run(tile, compositing, counters);
        }
        self.normals.queue(tile, compositing, counters);
        true
    }

    /// Computes density and colour at `points`: pairs of position and direction, at most as many as one block holds.
    /// `sigma` and `rgb` must hold zeros, since points in empty cells are skipped. An empty `rgb` requests no colour.
    pub fn points(
        &mut self,
        points: impl Iterator<Item = (Vec3, Vec3)>,
        sigma: &mut [f32],
        rgb: &mut [[f32; 3]],
        counters: &mut Counters,
    ) {
        let TileState { field, rays, density, .. } = &mut self.tile;
        let (shares, block) = self.colour.shares(*field);
        let colours = (!rgb.is_empty()).then_some((shares, block, &mut self.deferred.networks));
        evaluate_points(*field, points, rays.states, density, colours, counters, |i, density, colour| {
            put(sigma, i, density);
            if let Some(rgb) = rgb.get_mut(i) {
                *rgb = colour;
            }
        });
    }
}
