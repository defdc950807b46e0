//! The state of one call: a tile's rays in rounds, blocks of samples through the network.

use super::{Counters, Rect, RenderError, Target};
use crate::camera::Camera;
use crate::kernels::{Arena, BLOCK, Line, lines_for};
use crate::math::Math;
use crate::network::{Network, Scratch};
use crate::plan::Plan;
use crate::ray::Ray;
use crate::volume::Accumulator;
use glam::Vec3;

/// Live samples a ray contributes to a round: few are wasted beyond the cut, and the bookkeeping
/// stays small beside the network.
const ROUND: usize = 4;

/// What one ray carries from round to round.
#[derive(Clone, Copy)]
struct RayState {
    ray: Ray,
    x: u32,
    y: u32,
    /// The next bin to look at, and the end of the bins.
    next: u32,
    end: u32,
    /// Samples the network was asked for.
    kept: u32,
    /// Column of the ray in [`Frame::direction`].
    column: u32,
    done: bool,
    gathered: Accumulator,
}

impl RayState {
    const NONE: Self = Self {
        ray: Ray { origin: Vec3::ZERO, dir: Vec3::NEG_Z },
        x: 0,
        y: 0,
        next: 0,
        end: 0,
        kept: 0,
        column: 0,
        done: true,
        gathered: Accumulator::NONE,
    };

    /// Moves `next` to the first live bin at or after it; `false` if there is none.
    #[inline]
    fn seek(&mut self, plan: &Plan<'_>) -> bool {
        while self.next < self.end {
            if plan.live(self.ray.at(plan.bins.at(self.next, 0.5))) {
                return true;
            }
            self.next += 1;
        }
        false
    }
}

/// Lengths of the slices a frame works in; the workspace query and the carving share them.
pub(super) struct Sizes {
    rays: usize,
    samples: usize,
    ray_columns: usize,
    encoded: usize,
    activation: usize,
    direction: usize,
}

impl Sizes {
    pub(super) fn of(network: &Network<'_>, plan: &Plan<'_>) -> Self {
        let samples = if network.whole_blocks() { BLOCK } else { plan.batch.samples };
        let rays = plan.batch.rays;
        let colour = plan.outputs.rgb;
        Self {
            rays,
            samples,
            ray_columns: if colour { rays.next_multiple_of(samples) } else { 0 },
            encoded: network.encoded_rows() * samples,
            activation: network.activation_rows() * samples,
            direction: if colour { network.direction_rows() } else { 0 },
        }
    }

    pub(super) fn lines(&self) -> usize {
        lines_for::<RayState>(self.rays)
            + lines_for::<f32>(3 * self.samples) * 3
            + lines_for::<u32>(self.samples)
            + lines_for::<f32>(self.samples) * 2
            + lines_for::<f32>(self.encoded)
            + lines_for::<f32>(self.activation) * 2
            + lines_for::<f32>(self.direction.saturating_mul(self.ray_columns))
    }
}

/// The state of one `render` call.
pub(super) struct Frame<'f, 'w> {
    plan: &'f Plan<'f>,
    network: &'f Network<'f>,
    rays: &'w mut [RayState],
    /// Rays of the tile that hit something.
    active: usize,
    /// The block being filled: `[3][samples]`, `[samples]`, `[samples]`.
    positions: &'w mut [f32],
    owner: &'w mut [u32],
    t: &'w mut [f32],
    queued: usize,
    sigma: &'w mut [f32],
    rgb: &'w mut [f32],
    /// `[3][samples]`: directions of a block of rays.
    dirs: &'w mut [f32],
    /// The direction's share of the colour branch: `[ray_columns / samples][rows][samples]`.
    direction: &'w mut [f32],
    scratch: Scratch<'w>,
    pub(super) counters: Counters,
}

impl<'f, 'w> Frame<'f, 'w> {
    pub(super) fn carve(
        network: &'f Network<'f>,
        plan: &'f Plan<'f>,
        lines: &'w mut [Line],
    ) -> Result<Self, RenderError> {
        let sizes = Sizes::of(network, plan);
        let too_small = RenderError::Memory { expected: sizes.lines(), found: lines.len() };
        if lines.len() < sizes.lines() {
            return Err(too_small);
        }
        let mut arena = Arena::new(lines);
        let rays = arena.slice(sizes.rays, RayState::NONE).ok_or(too_small)?;
        let owner = arena.slice(sizes.samples, 0u32).ok_or(too_small)?;
        let mut floats = |count| arena.slice(count, 0.0f32).ok_or(too_small);
        Ok(Self {
            plan,
            network,
            rays,
            active: 0,
            owner,
            positions: floats(3 * sizes.samples)?,
            t: floats(sizes.samples)?,
            queued: 0,
            sigma: floats(sizes.samples)?,
            rgb: floats(3 * sizes.samples)?,
            dirs: floats(3 * sizes.samples)?,
            direction: floats(sizes.direction.saturating_mul(sizes.ray_columns))?,
            scratch: Scratch {
                stride: sizes.samples,
                encoded: floats(sizes.encoded)?,
                front: floats(sizes.activation)?,
                back: floats(sizes.activation)?,
            },
            counters: Counters::default(),
        })
    }

    /// Renders one tile of at most `plan.batch.rays` pixels.
    pub(super) fn tile<M: Math>(&mut self, camera: &Camera, tile: Rect, target: &mut impl Target) {
        self.start(camera, tile, target);
        self.directions();
        while self.active > 0 {
            self.round::<M>();
            self.retire(camera, target);
        }
    }

    /// Makes the tile's rays; those that meet nothing are finished at once.
    fn start(&mut self, camera: &Camera, tile: Rect, target: &mut impl Target) {
        let plan = self.plan;
        self.active = 0;
        for y in tile.y..tile.y + tile.height {
            for x in tile.x..tile.x + tile.width {
                self.counters.rays += 1;
                let ray = camera.ray(x as f32 + 0.5, y as f32 + 0.5);
                let bins = match plan.bounds.clip(&ray, plan.near, plan.far) {
                    Some((enter, exit)) => plan.bins.overlapping(enter, exit),
                    None => 0..0,
                };
                let column = self.active as u32;
                let (next, end) = (bins.start, bins.end);
                let mut state = RayState { ray, x, y, next, end, column, done: false, ..RayState::NONE };
                if state.seek(plan) {
                    self.rays[self.active] = state;
                    self.active += 1;
                } else {
                    self.finish(&state, camera, target);
                }
            }
        }
    }

    /// The direction's share of the colour branch, for every active ray.
    fn directions(&mut self) {
        let rows = self.network.direction_rows();
        if self.direction.is_empty() {
            return;
        }
        let stride = self.scratch.stride;
        for (block, states) in self.rays[..self.active].chunks(stride).enumerate() {
            for (column, state) in states.iter().enumerate() {
                put_column(self.dirs, stride, column, state.ray.dir);
            }
            let out = &mut self.direction[block * rows * stride..(block + 1) * rows * stride];
            self.network.direction(self.plan.math, &mut self.scratch, self.dirs, out);
        }
        self.counters.macs += self.active as u64 * self.network.direction_macs() as u64;
    }

    /// A few live samples of every active ray.
    fn round<M: Math>(&mut self) {
        let plan = self.plan;
        for i in 0..self.active {
            for _ in 0..ROUND {
                let state = &mut self.rays[i];
                if !state.seek(plan) {
                    break;
                }
                let t = plan.bins.at(state.next, 0.5);
                state.next += 1;
                state.kept += 1;
                let p = state.ray.at(t);
                put_column(self.positions, self.scratch.stride, self.queued, p);
                self.t[self.queued] = t;
                self.owner[self.queued] = i as u32;
                self.queued += 1;
                if self.queued == self.scratch.stride {
                    self.flush::<M>();
                }
            }
        }
        self.flush::<M>();
    }

    /// Sends the queued samples through the network and adds them to their rays.
    fn flush<M: Math>(&mut self) {
        let (n, plan) = (self.queued, self.plan);
        if n == 0 {
            return;
        }
        self.queued = 0;
        self.evaluate_density(n);
        let seen = |i: usize| self.sigma[i] > 0.0 && !self.rays[self.owner[i] as usize].done;
        if plan.outputs.rgb && (0..n).any(seen) {
            self.evaluate_colour(n);
        } else {
            self.rgb.fill(0.0);
        }
        let stride = self.scratch.stride;
        for i in 0..n {
            let state = &mut self.rays[self.owner[i] as usize];
            if state.done {
                continue;
            }
            let sigma = self.sigma[i];
            let rgb = [self.rgb[i], self.rgb[stride + i], self.rgb[2 * stride + i]];
            // Colour counts only where there is density: elsewhere it may not have been computed,
            // and which blocks compute it depends on the batch.
            if sigma.is_nan() || (sigma > 0.0 && rgb.iter().any(|c| c.is_nan())) {
                self.counters.invalid_samples += 1;
                continue;
            }
            if sigma > 0.0 {
                state.gathered.add::<M>(sigma, rgb, self.t[i], plan.bins.delta());
                state.done = state.gathered.transmittance::<M>() < plan.transmittance_cut;
            }
        }
    }

    /// Trunk and density of the block's first `n` samples.
    fn evaluate_density(&mut self, n: usize) {
        self.network.trunk(self.plan.math, &mut self.scratch, self.positions);
        self.network.density(self.plan.math, &self.scratch, self.sigma);
        self.counters.samples_kept += n as u64;
        self.counters.density_evaluations += n as u64;
        self.counters.macs += (n * self.network.architecture().density_macs()) as u64;
    }

    /// Colours of the block whose trunk has just run.
    fn evaluate_colour(&mut self, n: usize) {
        let (stride, rows) = (self.scratch.stride, self.network.direction_rows());
        let (direction, rays, owner) = (&*self.direction, &*self.rays, &*self.owner);
        let spread = |to: &mut [f32]| {
            for i in 0..n {
                let column = rays[owner[i] as usize].column as usize;
                let from = &direction[column / stride * rows * stride + column % stride..];
                for row in 0..rows {
                    to[row * stride + i] = from[row * stride];
                }
            }
        };
        self.network.colour(self.plan.math, &mut self.scratch, spread, self.rgb);
        self.counters.colour_evaluations += n as u64;
        let architecture = self.network.architecture();
        self.counters.macs += (n * architecture.colour_macs()) as u64;
        // The direction's share was paid once per ray.
        self.counters.macs -= (n * self.network.direction_macs()) as u64;
    }

    /// Finishes the rays that see nothing more and closes their ranks.
    fn retire(&mut self, camera: &Camera, target: &mut impl Target) {
        let mut kept = 0;
        for i in 0..self.active {
            let mut state = self.rays[i];
            if state.done || !state.seek(self.plan) {
                self.finish(&state, camera, target);
            } else {
                self.rays[kept] = state;
                kept += 1;
            }
        }
        self.active = kept;
    }

    fn finish(&mut self, state: &RayState, camera: &Camera, target: &mut impl Target) {
        self.counters.samples_skipped += u64::from(self.plan.bins.count() - state.kept);
        let cosine = camera.z_per_distance(&state.ray);
        let background = if self.plan.outputs.rgb { self.plan.background } else { [0.0; 3] };
        target.put(state.x, state.y, &state.gathered.finish(background, self.plan.far, cosine));
    }

    /// Density and colour at up to one block of points.
    pub(super) fn points(
        &mut self,
        positions: &[[f32; 3]],
        dirs: &[[f32; 3]],
        sigma: &mut [f32],
        rgb: &mut [[f32; 3]],
    ) {
        let stride = self.scratch.stride;
        sigma.fill(0.0);
        rgb.fill([0.0; 3]);
        self.active = 0;
        for (i, (&p, &dir)) in positions.iter().zip(dirs).enumerate() {
            let (p, dir) = (Vec3::from(p), Vec3::from(dir));
            if self.plan.live(p) {
                let column = self.active;
                let ray = Ray { origin: p, dir };
                self.rays[column] = RayState { ray, x: i as u32, column: column as u32, ..RayState::NONE };
                put_column(self.positions, stride, column, p);
                self.owner[column] = column as u32;
                self.active += 1;
            }
        }
        if self.active == 0 {
            return;
        }
        self.directions();
        self.evaluate_density(self.active);
        if self.plan.outputs.rgb {
            self.evaluate_colour(self.active);
        }
        for column in 0..self.active {
            let i = self.rays[column].x as usize;
            let colour = match self.plan.outputs.rgb {
                true => core::array::from_fn(|c| self.rgb[c * stride + column]),
                false => [0.0f32; 3],
            };
            // As in a picture: what is no number is empty, and counted.
            let dense = self.sigma[column] > 0.0;
            if self.sigma[column].is_nan() || (dense && colour.iter().any(|c| c.is_nan())) {
                self.counters.invalid_samples += 1;
                continue;
            }
            sigma[i] = self.sigma[column];
            if !colour.iter().any(|c| c.is_nan()) {
                rgb[i] = colour;
            }
        }
    }
}

/// Writes `v` into column `column` of a `[3][stride]` block.
#[inline]
fn put_column(block: &mut [f32], stride: usize, column: usize, v: Vec3) {
    block[column] = v.x;
    block[stride + column] = v.y;
    block[2 * stride + column] = v.z;
}
