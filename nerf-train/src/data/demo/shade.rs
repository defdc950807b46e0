//! Colour of a surface point: pattern, one soft light, a sky, and highlights.

use super::shapes::{FLOOR, Look, Shape, lit, openness};
use glam::{DVec3, Vec3};

/// Unnormalised direction towards the light.
const LIGHT: Vec3 = Vec3::new(0.55, -0.75, 1.05);
const LIGHT_COLOUR: Vec3 = Vec3::new(1.08, 1.0, 0.88);
const SKY: Vec3 = Vec3::new(0.42, 0.47, 0.56);
const BOUNCE: Vec3 = Vec3::new(0.30, 0.25, 0.20);

/// Reflectance of a surface: linear `albedo`, strengths of highlight and mirror image, exponent of the highlight.
struct Surface {
    albedo: Vec3,
    highlight: f32,
    mirror: f32,
    exponent: f32,
}

/// Returns the display-encoded sRGB, 0 to 1, of `point` on `shape`. `normal`, `dir` (from the camera): unit vectors.
pub(super) fn colour(shape: &Shape, point: DVec3, normal: DVec3, dir: DVec3) -> [f32; 3] {
    let light_dir = LIGHT.normalize();
    let surface = surface(shape.look, (point - shape.centre).as_vec3(), point.as_vec3(), normal.as_vec3());
    let (n, view) = (normal.as_vec3(), -dir.as_vec3());
    let facing = n.dot(light_dir).max(0.0);
    // Starts off the surface, so that the surface does not shadow itself.
    let start = point + normal * 2e-3;
    let seen = if facing > 0.0 { lit(start, light_dir.as_dvec3()) as f32 } else { 0.0 };
    let open = openness(point, normal) as f32;
    let sky = BOUNCE.lerp(SKY, 0.5 + 0.5 * n.z) * open;
    let diffuse = surface.albedo * (LIGHT_COLOUR * (0.95 * facing * seen) + sky);

    let half = (light_dir + view).normalize_or(n);
    let blinn = n.dot(half).max(0.0).powf(surface.exponent) * surface.highlight * seen;
    let fresnel = 0.04 + 0.96 * (1.0 - n.dot(view).clamp(0.0, 1.0)).powi(5);
    let mirrored = sky_seen(2.0 * n.dot(view) * n - view) * (fresnel * surface.mirror * open);
    let linear = diffuse + LIGHT_COLOUR * blinn + mirrored;
    linear.to_array().map(|v| encode(v.clamp(0.0, 1.0)))
}

/// Returns the linear colour that a polished surface mirrors from the unit direction `dir`: sky, ground or window.
fn sky_seen(dir: Vec3) -> Vec3 {
    let up = smooth(-0.15, 0.5, dir.z);
    let ground = Vec3::new(0.16, 0.14, 0.13);
    let window = smooth(0.90, 0.96, dir.dot(Vec3::new(-0.62, -0.35, 0.7).normalize()));
    ground.lerp(Vec3::new(0.75, 0.85, 1.0), up) + Vec3::splat(1.6 * window)
}

/// Returns the reflectance, at one point, of a surface with the appearance `look`. `p`: the point relative to the
/// shape's centre. `world`: the point in world coordinates. `n`: unit normal.
fn surface(look: Look, p: Vec3, world: Vec3, n: Vec3) -> Surface {
    let plain = |albedo| Surface { albedo, highlight: 0.08, mirror: 0.2, exponent: 24.0 };
    let glossy = |albedo| Surface { albedo, highlight: 0.9, mirror: 1.0, exponent: 120.0 };
    let around = p.y.atan2(p.x);
    match look {
        Look::Plinth => {
            let (cream, slate) = (rgb(236, 226, 205), rgb(66, 92, 104));
            if n.z < 0.5 || world.z < FLOOR as f32 - 0.02 {
                return plain(rgb(196, 178, 150));
            }
            // A border around a chequerboard whose squares have the side 0.2.
            let inside = world.truncate().length() < 0.86;
            let even = ((world.x / 0.2).floor() + (world.y / 0.2).floor()).rem_euclid(2.0) < 0.5;
            plain(if inside && even { slate } else { cream })
        }
        Look::Marble => {
            let drift = fbm(p * 4.0) * 2.0 - 1.0;
            let vein = (6.0 * (p.z + 0.4 * p.x) + 5.0 * drift).sin();
            let deep = rgb(8, 92, 104).lerp(rgb(24, 140, 140), 0.5 + 0.5 * drift);
            glossy(deep.lerp(rgb(226, 240, 228), smooth(0.72, 0.98, vein)))
        }
        Look::Planks => {
            let stripe = ((world.x + world.y + 1.6 * world.z) * 7.0).rem_euclid(1.0);
            let grain = 0.85 + 0.3 * fbm(p * Vec3::new(9.0, 9.0, 2.5));
            plain(if stripe < 0.5 { rgb(240, 176, 48) } else { rgb(246, 224, 170) } * grain)
        }
        Look::Candy => {
            let outwards = p.truncate().length() - 0.25;
            let tube = p.z.atan2(outwards);
            let turns = (around * 10.0 + tube) / std::f32::consts::TAU;
            glossy(if turns.rem_euclid(1.0) < 0.5 { rgb(214, 58, 70) } else { rgb(244, 236, 226) })
        }
        Look::Pearl => Surface {
            albedo: rgb(214, 206, 224).lerp(rgb(150, 136, 196), fbm(p * 9.0)),
            highlight: 0.6,
            mirror: 1.6,
            exponent: 60.0,
        },
        Look::Column => {
            let band = (p.z * 9.0).rem_euclid(1.0) < 0.5;
            let flute = 0.88 + 0.12 * (around * 12.0).cos();
            plain(if band { rgb(52, 122, 84) } else { rgb(146, 196, 120) } * flute)
        }
        Look::Cherry => glossy(rgb(190, 28, 44)),
    }
}

/// Converts an sRGB triple to linear colour, 0 to 1.
fn rgb(r: u8, g: u8, b: u8) -> Vec3 {
    Vec3::from_array([r, g, b].map(|v| {
        let v = f32::from(v) / 255.0;
        if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
    }))
}

fn encode(v: f32) -> f32 {
    if v <= 0.003_130_8 { 12.92 * v } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

fn smooth(low: f32, high: f32, v: f32) -> f32 {
    let s = ((v - low) / (high - low)).clamp(0.0, 1.0);
    s * s * (3.0 - 2.0 * s)
}

/// Returns a weighted mean of three octaves of value noise at `p`, in 0..=1.
fn fbm(p: Vec3) -> f32 {
    (4.0 * noise(p) + 2.0 * noise(p * 2.03 + 17.0) + noise(p * 4.01 + 31.0)) / 7.0
}

/// Returns value noise at `p`: fixed values in 0..=1 at the integer points, interpolated smoothly.
fn noise(p: Vec3) -> f32 {
    let cell = p.floor();
    let f = p - cell;
    let f = f * f * (3.0 - 2.0 * f);
    let [x, y, z] = cell.to_array().map(|v| v as i32);
    let corner = |i: i32, j: i32, k: i32| hash(x + i, y + j, z + k);
    let mix = |a: f32, b: f32, s: f32| a + (b - a) * s;
    let edge = |j, k| mix(corner(0, j, k), corner(1, j, k), f.x);
    mix(mix(edge(0, 0), edge(1, 0), f.y), mix(edge(0, 1), edge(1, 1), f.y), f.z)
}

/// Returns a pseudo-random value in 0..=1 for an integer point.
fn hash(x: i32, y: i32, z: i32) -> f32 {
    let mut h = (x as u32).wrapping_mul(0x9E37_79B1)
        ^ (y as u32).wrapping_mul(0x85EB_CA77)
        ^ (z as u32).wrapping_mul(0xC2B2_AE3D);
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    ((h ^ (h >> 15)) >> 8) as f32 / 16_777_215.0
}
