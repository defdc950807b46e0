//! Queries of the field: density and colour at points, without compositing.

use super::frame::{Frame, columns_of};
use super::march::RayState;
use crate::camera::Ray;
use crate::memory::{at, column, head, head_mut, put, put_column};
use glam::Vec3;

impl Frame<'_, '_> {
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
            if self.plan.occupied(origin)
                && let Some(place) = self.rays.get_mut(n)
            {
                *place = RayState { ray: Ray { origin, dir }, x: i as u32, ..RayState::NONE };
                n += 1;
            }
        }
        if n == 0 {
            return;
        }
        let coloured = self.plan.outputs.rgb && !rgb.is_empty();
        if coloured {
            self.directions(n);
        }
        let stride = columns_of(self.network, n);
        for column in 0..stride {
            let state = at(self.rays, column.min(n - 1));
            put_column(self.positions, stride, column, state.ray.origin.to_array());
        }
        self.evaluate_density(n);
        self.counters.add_density(self.network, n);
        if coloured && self.deferred.is_on() {
            let dir = |i: usize| at(&*self.rays, i).ray.dir;
            let (networks, scratch) = (&mut self.deferred.networks, &mut self.scratch);
            networks.of_samples(self.network, self.plan, scratch, (n, dir), &mut self.counters);
        } else if coloured {
            for (column, owner) in head_mut(self.picks.owner, n).iter_mut().enumerate() {
                *owner = column as u32;
            }
            self.evaluate_colour(n);
        }
        let colours = if self.deferred.is_on() { &*self.deferred.networks.rgb } else { &*self.rgb };
        for (i, state) in head(self.rays, n).iter().enumerate() {
            let colour = match coloured {
                true => column(colours, stride, i),
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
            } else if coloured {
                put(rgb, state.x as usize, colour);
            }
        }
    }
}
