//! Shapes of the demo scene: exact distances, bounding spheres, and intersections with rays.

use glam::{DVec2, DVec3};

pub(super) const FLOOR: f64 = -0.38;

/// Geometry of a shape relative to its centre; z is up.
#[derive(Clone, Copy)]
pub(super) enum Form {
    Sphere(f64),
    /// Rounded box. `half`: half side lengths, rounding included. `round`: edge radius. `turn`: (cos, sin) of the yaw.
    Block {
        half: DVec3,
        round: f64,
        turn: DVec2,
    },
    /// Rounded cylinder. `half`: half height, rounding included. `round`: edge radius.
    Drum {
        radius: f64,
        half: f64,
        round: f64,
    },
    /// Torus around z. `radius`: radius of the circle that the tube follows. `tube`: radius of the tube.
    Ring {
        radius: f64,
        tube: f64,
    },
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Look {
    Plinth,
    Marble,
    Planks,
    Candy,
    Pearl,
    Column,
    Cherry,
}

#[derive(Clone, Copy)]
pub(super) struct Shape {
    pub(super) form: Form,
    pub(super) centre: DVec3,
    /// Radius of a bounding sphere around `centre`.
    pub(super) reach: f64,
    pub(super) look: Look,
}

pub(super) static SCENE: [Shape; 7] = [
    Shape {
        form: Form::Drum { radius: 0.96, half: 0.08, round: 0.03 },
        centre: DVec3::new(0.0, 0.0, FLOOR - 0.08),
        reach: 0.964,
        look: Look::Plinth,
    },
    Shape {
        form: Form::Sphere(0.43),
        centre: DVec3::new(-0.33, 0.28, FLOOR + 0.43),
        reach: 0.43,
        look: Look::Marble,
    },
    Shape {
        form: Form::Block {
            half: DVec3::new(0.23, 0.23, 0.31),
            round: 0.05,
            turn: DVec2::new(0.866_025_4, 0.5),
        },
        centre: DVec3::new(0.46, 0.34, FLOOR + 0.31),
        reach: 0.45,
        look: Look::Planks,
    },
    Shape {
        form: Form::Ring { radius: 0.25, tube: 0.11 },
        centre: DVec3::new(0.34, -0.44, FLOOR + 0.11),
        reach: 0.36,
        look: Look::Candy,
    },
    // The sphere rests in the ring: its centre is 0.31 from the circle that the ring's tube follows.
    Shape {
        form: Form::Sphere(0.20),
        centre: DVec3::new(0.34, -0.44, FLOOR + 0.11 + 0.183_303),
        reach: 0.20,
        look: Look::Pearl,
    },
    Shape {
        form: Form::Drum { radius: 0.15, half: 0.22, round: 0.04 },
        centre: DVec3::new(-0.42, -0.50, FLOOR + 0.22),
        reach: 0.267,
        look: Look::Column,
    },
    Shape {
        form: Form::Sphere(0.15),
        centre: DVec3::new(0.46, 0.34, FLOOR + 0.62 + 0.15),
        reach: 0.15,
        look: Look::Cherry,
    },
];

/// First hit of a ray with the scene, at distance `t` along the ray.
pub(super) struct Found {
    pub(super) t: f64,
    pub(super) shape: &'static Shape,
    pub(super) normal: DVec3,
}

impl Shape {
    /// Returns the exact signed distance of `point` from the shape's surface, world units, negative inside.
    pub(super) fn distance(&self, point: DVec3) -> f64 {
        let p = point - self.centre;
        match self.form {
            Form::Sphere(radius) => p.length() - radius,
            Form::Block { half, round, turn } => {
                let local = DVec3::new(p.x * turn.x + p.y * turn.y, p.y * turn.x - p.x * turn.y, p.z);
                let q = local.abs() - (half - round);
                q.max(DVec3::ZERO).length() + q.max_element().min(0.0) - round
            }
            Form::Drum { radius, half, round } => {
                let q = DVec2::new(p.truncate().length() - (radius - round), p.z.abs() - (half - round));
                q.max(DVec2::ZERO).length() + q.max_element().min(0.0) - round
            }
            Form::Ring { radius, tube } => DVec2::new(p.truncate().length() - radius, p.z).length() - tube,
        }
    }

    /// Returns the distances at which a ray enters (0 if inside) and leaves the sphere of radius `reach + margin`
    /// around `centre`; `None` for a miss. `dir` has unit length.
    pub(super) fn bounds(&self, origin: DVec3, dir: DVec3, margin: f64) -> Option<(f64, f64)> {
        let to = self.centre - origin;
        let middle = to.dot(dir);
        let reach = self.reach + margin;
        let half2 = reach * reach - (to - dir * middle).length_squared();
        let half = if half2 >= 0.0 { half2.sqrt() } else { return None };
        (middle + half > 0.0).then_some(((middle - half).max(0.0), middle + half))
    }

    /// Returns the distance, world units, to a ray's first hit before `limit`, if any. `origin` must be outside.
    fn hit(&self, origin: DVec3, dir: DVec3, limit: f64) -> Option<f64> {
        const STEPS: usize = 400;
        const CLOSE: f64 = 1e-8;
        const SLOPE_STEP: f64 = 1e-7;
        let (enter, leave) = self.bounds(origin, dir, 0.0)?;
        if let Form::Sphere(_) = self.form {
            return (enter < limit).then_some(enter);
        }
        let convex = !matches!(self.form, Form::Ring { .. });
        let at = |t: f64| self.distance(origin + dir * t);
        let (mut t, end) = (enter, leave.min(limit));
        for _ in 0..STEPS {
            let distance = at(t);
            if distance < CLOSE {
                return Some(t);
            }
            t += if convex {
                // Along a ray, the distance to a convex shape is a convex function. Newton's method therefore reaches
                // its first root from the left, and a slope of 0 or more means that there is no root.
                let slope = (at(t + SLOPE_STEP) - distance) / SLOPE_STEP;
                if slope >= 0.0 {
                    return None;
                }
                distance / -slope
            } else {
                distance
            };
            if t > end {
                return None;
            }
        }
        // The ray passes close along the surface without touching it.
        None
    }

    fn normal(&self, point: DVec3) -> DVec3 {
        if let Form::Sphere(_) = self.form {
            return (point - self.centre).normalize_or(DVec3::Z);
        }
        const STEP: f64 = 1e-5;
        let slope = |axis: DVec3| self.distance(point + axis * STEP) - self.distance(point - axis * STEP);
        DVec3::new(slope(DVec3::X), slope(DVec3::Y), slope(DVec3::Z)).normalize_or(DVec3::Z)
    }
}

/// Finds the first hit, if any, of the ray with any shape; `dir` has unit length, and `origin` is outside all shapes.
pub(super) fn first(origin: DVec3, dir: DVec3) -> Option<Found> {
    let mut nearest: Option<(f64, &Shape)> = None;
    for shape in &SCENE {
        let limit = nearest.map_or(f64::INFINITY, |(t, _)| t);
        if let Some(t) = shape.hit(origin, dir, limit) {
            nearest = Some((t, shape));
        }
    }
    nearest.map(|(t, shape)| Found { t, shape, normal: shape.normal(origin + dir * t) })
}

/// Returns the visible fraction, 0..=1, of a small round light, seen from `point`. `dir`: unit direction to the light.
///
/// # Source
/// Quilez, "Soft shadows in raymarched SDFs": the least ratio of shape distance to ray distance gives the penumbra.
pub(super) fn lit(point: DVec3, dir: DVec3) -> f64 {
    const SHARPNESS: f64 = 9.0;
    const STEPS: usize = 40;
    /// Distance from a shape, world units, beyond which the shape casts no penumbra.
    const MARGIN: f64 = 0.2;
    let mut light: f64 = 1.0;
    for shape in &SCENE {
        // The light is above the plinth, so that the plinth shades no point at or above its own top.
        if shape.look == Look::Plinth && point.z >= FLOOR {
            continue;
        }
        let Some((enter, leave)) = shape.bounds(point, dir, MARGIN) else { continue };
        let mut t = enter.max(0.01);
        for _ in 0..STEPS {
            let distance = shape.distance(point + dir * t);
            light = light.min(SHARPNESS * distance / t);
            t += distance.clamp(0.015, 0.3);
            if light <= 0.0 {
                return 0.0;
            }
            if t > leave {
                break;
            }
        }
    }
    light * light * (3.0 - 2.0 * light)
}

/// Returns the ambient occlusion: factor 0.25 (enclosed) to 1 (open) on light from the hemisphere around `normal`.
pub(super) fn openness(point: DVec3, normal: DVec3) -> f64 {
    const PROBES: u32 = 4;
    let (mut closed, mut total) = (0.0, 0.0);
    for step in 1..=PROBES {
        let reach = 0.07 * f64::from(step);
        let weight = 0.7f64.powi(step as i32);
        let probe = point + normal * reach;
        let mut free = reach;
        for shape in &SCENE {
            let far = shape.reach + free;
            if (probe - shape.centre).length_squared() < far * far {
                free = free.min(shape.distance(probe));
            }
        }
        closed += weight * (1.0 - (free / reach).max(0.0));
        total += weight;
    }
    1.0 - 0.75 * closed / total
}
