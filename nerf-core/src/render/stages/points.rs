//! Queries of a field: density and colour at points, without compositing.

use super::colour::DirectionShares;
use super::density::Density;
use super::per_ray::RayNetworks;
use crate::memory::{at, column, head};
use crate::render::Counters;
use crate::render::field::Field;
use crate::render::march::RayState;
use glam::Vec3;

/// The stage that computes the colours of points.
pub(in crate::render) enum PointColour<'a, 'w> {
    /// No stage: density alone is requested.
    None,
    /// The colour branch at samples, and memory for the colours of a block.
    Samples(DirectionShares<'a>, &'a mut [f32]),
    /// The colour branch once a ray, each ray of one point.
    Rays(&'a mut RayNetworks<'w>),
}

/// Fills `rays` with the points that lie in occupied cells, in the network's space. Returns their number.
pub(in crate::render) fn take_points(
    field: Field<'_>,
    points: impl Iterator<Item = (Vec3, Vec3)>,
    rays: &mut [RayState],
) -> usize {
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
    n
}

/// Evaluates a field at points, and passes index, density and colour of each to `put`. A point whose density is NaN
/// is only counted; a colour that is NaN becomes black.
pub(in crate::render) fn evaluate_points(
    field: Field<'_>,
    points: &[RayState],
    density: &mut Density<'_>,
    mut colour: PointColour<'_, '_>,
    counters: &mut Counters,
    mut put: impl FnMut(usize, f32, [f32; 3]),
) {
    let n = points.len();
    if n == 0 {
        return;
    }
    if let PointColour::Samples(shares, dirs) = &mut colour {
        shares.fill(field, &mut density.scratch, dirs, points, counters);
    }
    density.evaluate_points(field, points);
    counters.add_density(field.network, n);
    let colours = match colour {
        PointColour::None => None,
        PointColour::Samples(shares, rgb) => {
            shares.evaluate(field, &mut density.scratch, head(density.owner, n), rgb);
            counters.add_colour(field.network, n);
            Some(&*rgb)
        }
        PointColour::Rays(networks) => {
            Some(networks.of_samples(field, &mut density.scratch, points, counters))
        }
    };
    for (i, point) in points.iter().enumerate() {
        let sigma = at(density.sigma, i);
        let mut rgb = colours.map_or([0.0; 3], |colours| column(colours, field.columns(n), i));
        let black = rgb.iter().any(|c| c.is_nan());
        counters.invalid_samples += u64::from(sigma.is_nan() || (black && sigma > 0.0));
        if black {
            rgb = [0.0; 3];
        }
        if !sigma.is_nan() {
            put(point.pixel.x as usize, sigma, rgb);
        }
    }
}
