//! Queries of a field: density and colour at points, without compositing.

use super::colour::DirectionShares;
use super::density::Density;
use super::per_ray::RayNetworks;
use crate::memory::{at, column, head, put as put_value, put_column};
use crate::render::Counters;
use crate::render::field::Field;
use crate::render::march::RayState;
use glam::Vec3;

/// Evaluates a field at `points`, pairs of position and direction. For each point in an occupied cell, passes index,
/// density and colour to `put`. A point whose density is NaN is counted as invalid and not passed on. A NaN colour
/// becomes black.
///
/// `rays`: memory for one ray state per point. `colours`: three buffers, for the contributions of directions, for the
/// colours of a block, and for deferred shading; `None` if only density is requested.
pub(in crate::render) fn evaluate_points(
    field: Field<'_>,
    points: impl Iterator<Item = (Vec3, Vec3)>,
    rays: &mut [RayState],
    density: &mut Density<'_>,
    colours: Option<(DirectionShares<'_>, &mut [f32], &mut RayNetworks<'_>)>,
    counters: &mut Counters,
    mut put: impl FnMut(usize, f32, [f32; 3]),
) {
    let mut n = 0;
    for (i, (p, dir)) in points.enumerate() {
        let origin = field.plan.inside(p);
        if field.plan.occupied(origin)
            && let Some(state) = rays.get_mut(n)
        {
            *state = RayState::of_point(origin, dir, i);
            n += 1;
        }
    }
    if n == 0 {
        return;
    }
    let (points, stride) = (head(rays, n), field.columns(n));
    let mut colours = colours.filter(|_| field.plan.outputs.rgb);
    if let Some((shares, dirs, _)) = &mut colours {
        shares.fill(field, &mut density.scratch, dirs, points, counters);
    }
    for column in 0..stride {
        let index = column.min(n - 1);
        put_value(density.owner, column, index as u32);
        put_column(density.positions, stride, column, at(points, index).pixel.ray.origin.to_array());
    }
    density.evaluate(field, n);
    counters.add_density(field.network, n);
    let colours = colours.map(|(shares, rgb, networks)| {
        if field.shades_rays() {
            return networks.of_samples(field, &mut density.scratch, points, counters);
        }
        shares.evaluate(field, &mut density.scratch, head(density.owner, n), rgb);
        counters.add_colour(field.network, n);
        rgb
    });
    for (i, point) in points.iter().enumerate() {
        let sigma = at(density.sigma, i);
        let rgb = colours.as_ref().map_or([0.0; 3], |colours| column(colours, stride, i));
        let black = rgb.iter().any(|c| c.is_nan());
        counters.invalid_samples += u64::from(sigma.is_nan() || (black && sigma > 0.0));
        let rgb = if black { [0.0; 3] } else { rgb };
        if !sigma.is_nan() {
            put(point.pixel.x as usize, sigma, rgb);
        }
    }
}
