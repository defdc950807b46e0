//! Depth of field: rays through a thin lens.

use crate::camera::{Pose, Ray};
use crate::math::{Math, polynomial::Polynomial};
use crate::plan::{Effects, ThinLens};
use crate::sampling::random::{GOLDEN, Purpose, pixel_stream, rank, uniform, uniform_u32};
use crate::simd::Lanes;
use glam::Vec3;

#[cfg(test)]
mod tests;

/// Returns the index of the aperture's ring through which ray `ray` of every pixel passes; 0 without depth of field.
/// The rings, one per ray of a pixel, have equal area.
///
/// Rays of consecutive indices are neighbours in the pixel, and pass through rings that are far apart. If ray and ring
/// had the same index, all rays at one side of the pixel would pass near the aperture's rim.
#[inline]
pub(crate) fn area(effects: &Effects, ray: u32) -> u32 {
    /// Fractional part of the silver ratio, in units of 2^-32.
    const SILVER: u32 = 0x6a09_e667;
    match effects.depth_of_field {
        None => 0,
        Some(_) => rank(SILVER, ray, effects.anti_aliasing.into()),
    }
}

/// Returns the ray of pixel `(x, y)` through a random point in the aperture's ring of index `area` (see [`area`]).
/// `pinhole`: the pixel's ray through the aperture's centre; returned unchanged if `effects` has no depth of field.
#[inline]
pub(crate) fn through_lens(
    effects: &Effects,
    pose: &Pose,
    pinhole: Ray,
    (x, y): (u32, u32),
    area: u32,
) -> Ray {
    match &effects.depth_of_field {
        None => pinhole,
        Some(lens) => lens_ray(lens, pose, &pinhole, aperture_point(effects, pixel_stream(x, y), area)),
    }
}

/// Returns the ray from point `at` of the aperture (in aperture radii) to the point where `pinhole` meets the plane of
/// focus. Returns `pinhole` itself if it does not meet that plane.
///
/// The aperture is perpendicular to the view axis, so that the origins of all rays have z_depth 0. A point at distance
/// `t` along the returned ray therefore has a z_depth of `t` times the cosine between that ray and the view axis.
#[inline(never)]
fn lens_ray(lens: &ThinLens, pose: &Pose, pinhole: &Ray, at: (f32, f32)) -> Ray {
    let offset = pose.rotation * (Vec3::new(at.0, at.1, 0.0) * lens.aperture_radius);
    // Points are relative to the camera's centre: no precision is lost far from the world's origin.
    let cosine = pinhole.dir.dot(pose.forward());
    // A fisheye also sees directions at 90° and more from the view axis, which do not meet the plane of focus.
    if cosine <= 0.0 {
        return *pinhole;
    }
    let focus = pinhole.dir * (lens.focus_distance / cosine);
    Ray { origin: pinhole.origin + offset, dir: (focus - offset).normalize() }
}

/// Returns a random point in ring `area` ([`area`]) of the unit disc. `stream`: the pixel's stream ([`pixel_stream`]).
///
/// Sunflower pattern: one point in each ring of equal area, from the middle outwards; successive points are the golden
/// angle apart. The radial position within the rings and the angle of the first point are random for each pixel. Each
/// point is thus uniform over its ring, and neighbouring pixels differ.
///
/// # Source
/// Vogel 1979; deviation: the radial position and the first angle are random.
fn aperture_point(effects: &Effects, stream: u64, area: u32) -> (f32, f32) {
    let seed = effects.jitter.map_or(0, |jitter| jitter.seed);
    let start = uniform(seed, Purpose::Aperture, stream, 0);
    let radius = Lanes::sqrt((area as f32 + start) / f32::from(effects.anti_aliasing));
    let turn = uniform_u32(seed, Purpose::Aperture, stream, 1).wrapping_add(area.wrapping_mul(GOLDEN));
    let (sin, cos) = Polynomial::sin_cos_pi((turn >> 8) as f32 / 8_388_608.0);
    (radius * cos, radius * sin)
}
