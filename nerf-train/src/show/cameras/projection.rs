//! From world to picture, as the person who looks at it sees it.

use glam::Vec3;

/// Nearest distance that is drawn, as a share of the viewpoint's distance from what it looks at.
const NEAR_SHARE: f32 = 0.01;
/// Share of the picture, from its middle to its edge, that what is shown may fill.
const FILLED: f32 = 0.94;

/// A perspective viewpoint; pixels count from the top left, depth along the view axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viewpoint {
    eye: Vec3,
    right: Vec3,
    up: Vec3,
    forward: Vec3,
    /// Focal length, pixels.
    focal: f32,
    /// The picture's middle, pixels.
    middle: (f32, f32),
    /// Nearest depth that is drawn, world units.
    near: f32,
}

/// A point in the picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Projected {
    /// Pixels from the left.
    pub x: f32,
    /// Pixels from the top.
    pub y: f32,
    /// 1 / depth, 1/world unit: linear over the picture, larger is nearer.
    pub inverse_depth: f32,
}

impl Viewpoint {
    /// Looks from `towards` (from scene to viewer) at `points`, as near as they all fit in.
    ///
    /// `up`: world direction upwards in the picture, not parallel to `towards`. `fov`: vertical field
    /// of view, degrees. `points`: world units.
    pub fn fitted(
        points: &[Vec3],
        towards: Vec3,
        up: Vec3,
        (width, height): (usize, usize),
        fov: f32,
    ) -> Self {
        let forward = -towards.normalize_or(Vec3::Z);
        let right = forward.cross(up).try_normalize().unwrap_or_else(|| forward.any_orthonormal_vector());
        let (width, height) = (width as f32, height as f32);
        let focal = 0.5 * height / (0.5 * fov.to_radians()).tan();
        // Half extents of the filled part at depth 1.
        let (half_x, half_y) = (0.5 * FILLED * width / focal, 0.5 * FILLED * height / focal);
        let (low, high) = points
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), &p| (low.min(p), high.max(p)));
        let mut target = if low.is_finite() && high.is_finite() { 0.5 * (low + high) } else { Vec3::ZERO };
        let radius = points.iter().map(|p| p.distance(target)).fold(0.0, f32::max).max(1e-6);
        let mut view = Self {
            eye: Vec3::ZERO,
            right,
            up: right.cross(forward),
            forward,
            focal,
            middle: (0.5 * width, 0.5 * height),
            near: 0.0,
        };
        // Far enough for the bounding sphere, then nearer step by step.
        let mut distance = radius / half_x.min(half_y).atan().sin();
        for _ in 0..24 {
            view.eye = target - forward * distance;
            let ((x0, y0), (x1, y1)) = view.extent(points);
            target += (right * (0.5 * (x0 + x1)) + view.up * (0.5 * (y0 + y1))) * distance;
            let filled = (0.5 * (x1 - x0) / half_x).max(0.5 * (y1 - y0) / half_y);
            // Halfway only: perspective makes the near side grow faster than the rest.
            distance = (distance * (0.5 + 0.5 * filled)).max(1.02 * radius);
        }
        view.eye = target - forward * distance;
        // Whatever the steps left sticking out.
        for _ in 0..40 {
            let ((x0, y0), (x1, y1)) = view.extent(points);
            if x1.max(-x0) <= half_x && y1.max(-y0) <= half_y {
                break;
            }
            distance *= 1.02;
            view.eye = target - forward * distance;
        }
        view.near = NEAR_SHARE * distance;
        view
    }

    /// Smallest and largest x and y of points in front of the eye, at depth 1.
    fn extent(&self, points: &[Vec3]) -> ((f32, f32), (f32, f32)) {
        let start = ((f32::INFINITY, f32::INFINITY), (f32::NEG_INFINITY, f32::NEG_INFINITY));
        let all = points.iter().map(|&p| self.to_eye(p)).filter(|p| p.z > 0.0);
        let ((x0, y0), (x1, y1)) = all.fold(start, |((x0, y0), (x1, y1)), p| {
            let (x, y) = (p.x / p.z, p.y / p.z);
            ((x0.min(x), y0.min(y)), (x1.max(x), y1.max(y)))
        });
        if x0 <= x1 { ((x0, y0), (x1, y1)) } else { ((0.0, 0.0), (0.0, 0.0)) }
    }

    /// Right, up and forward of the eye, world units.
    fn to_eye(self, p: Vec3) -> Vec3 {
        let p = p - self.eye;
        Vec3::new(p.dot(self.right), p.dot(self.up), p.dot(self.forward))
    }

    fn of_eye(&self, p: Vec3) -> Projected {
        let inverse_depth = 1.0 / p.z;
        let (x, y) = (p.x * inverse_depth * self.focal, p.y * inverse_depth * self.focal);
        Projected { x: self.middle.0 + x, y: self.middle.1 - y, inverse_depth }
    }

    /// Where `p` is in the picture; `None` behind the near plane.
    pub fn project(&self, p: Vec3) -> Option<Projected> {
        let p = self.to_eye(p);
        (p.z >= self.near && p.is_finite()).then(|| self.of_eye(p))
    }

    /// The part of the segment that is in front of the near plane.
    pub fn segment(&self, a: Vec3, b: Vec3) -> Option<[Projected; 2]> {
        let (a, b) = (self.to_eye(a), self.to_eye(b));
        if !(a.is_finite() && b.is_finite()) || a.z.max(b.z) < self.near {
            return None;
        }
        let cut = |p: Vec3, other: Vec3| if p.z < self.near { self.crossing(p, other) } else { p };
        Some([self.of_eye(cut(a, b)), self.of_eye(cut(b, a))])
    }

    fn crossing(&self, behind: Vec3, ahead: Vec3) -> Vec3 {
        let mut p = behind + (ahead - behind) * ((self.near - behind.z) / (ahead.z - behind.z));
        p.z = self.near;
        p
    }

    /// The part of a convex polygon in front of the near plane, with what its corners carry: `uv`.
    ///
    /// # Source
    /// Sutherland and Hodgman 1974, against one plane.
    pub fn polygon(&self, corners: &[(Vec3, [f32; 2])]) -> Vec<(Projected, [f32; 2])> {
        let eye: Vec<(Vec3, [f32; 2])> = corners.iter().map(|&(p, uv)| (self.to_eye(p), uv)).collect();
        let mut kept = Vec::with_capacity(corners.len() + 1);
        for (i, &(p, uv)) in eye.iter().enumerate() {
            let (next, next_uv) = eye[(i + 1) % eye.len()];
            if p.z >= self.near {
                kept.push((self.of_eye(p), uv));
            }
            if (p.z >= self.near) != (next.z >= self.near) {
                let share = (self.near - p.z) / (next.z - p.z);
                let at = std::array::from_fn(|i| uv[i] + share * (next_uv[i] - uv[i]));
                kept.push((self.of_eye(self.crossing(p, next)), at));
            }
        }
        kept
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From z = `distance` down on the origin.
    fn down(points: &[Vec3], size: (usize, usize)) -> Viewpoint {
        Viewpoint::fitted(points, Vec3::Z, Vec3::Y, size, 40.0)
    }

    fn cube() -> Vec<Vec3> {
        (0..8).map(|i| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * 2.0 - 1.0).collect()
    }

    #[test]
    fn right_is_right_and_up_is_up() {
        let view = down(&cube(), (200, 100));
        let middle = view.project(Vec3::ZERO).unwrap();
        assert!((middle.x - 100.0).abs() < 1e-3 && (middle.y - 50.0).abs() < 1e-3);
        let at = view.project(Vec3::new(0.5, 0.25, 0.0)).unwrap();
        assert!(at.x > middle.x && at.y < middle.y);
        // Similar triangles: half as far to the side is half as many pixels.
        assert!(((at.x - middle.x) - 2.0 * (middle.y - at.y)).abs() < 1e-3);
        assert!(view.project(Vec3::Z).unwrap().inverse_depth > middle.inverse_depth);
    }

    #[test]
    fn what_is_fitted_is_whole_and_fills_the_picture() {
        let shifted: Vec<Vec3> = cube().iter().map(|&p| p * Vec3::new(9.0, 1.0, 3.0) + 100.0).collect();
        for points in [cube(), shifted] {
            for towards in [Vec3::new(1.0, 2.0, 0.7), Vec3::NEG_X, Vec3::new(0.01, 1.0, 1.0)] {
                for size in [(400, 100), (300, 300), (100, 500)] {
                    let view = Viewpoint::fitted(&points, towards, Vec3::Z, size, 40.0);
                    let seen: Vec<_> = points.iter().map(|&p| view.project(p).expect("in front")).collect();
                    let (w, h) = (size.0 as f32, size.1 as f32);
                    let inside = |p: &Projected| (0.0..w).contains(&p.x) && (0.0..h).contains(&p.y);
                    assert!(seen.iter().all(inside), "{size:?} {towards}: {seen:?}");
                    let most =
                        seen.iter().map(|p| ((2.0 * p.x / w - 1.0).abs()).max((2.0 * p.y / h - 1.0).abs()));
                    assert!(most.fold(0.0, f32::max) > 0.7, "{size:?} {towards}");
                }
            }
        }
    }

    #[test]
    fn segments_and_polygons_end_at_the_near_plane() {
        let view = down(&cube(), (100, 100));
        let (ahead, behind) = (Vec3::ZERO, view.eye + Vec3::new(0.3, 0.0, 5.0));
        let [a, b] = view.segment(ahead, behind).unwrap();
        assert_eq!(a, view.project(ahead).unwrap());
        assert!((b.inverse_depth * view.near - 1.0).abs() < 1e-5);
        assert_eq!(view.project(behind), None);
        assert_eq!(view.segment(behind, behind + Vec3::Z), None);
        assert_eq!(view.segment(ahead, Vec3::splat(f32::NAN)), None);

        // One corner of a triangle behind the eye: two crossings, with uv in proportion.
        let (p, q) = (ahead - Vec3::X, ahead + Vec3::X);
        let cut = view.polygon(&[(p, [0.0, 0.0]), (q, [1.0, 0.0]), (behind, [0.0, 1.0])]);
        assert_eq!(cut.len(), 4);
        assert!(cut.iter().all(|(p, _)| p.inverse_depth <= 1.0 / view.near * 1.0001));
        let depth = |p: Vec3| view.to_eye(p).z;
        let share = (depth(ahead) - view.near) / (depth(ahead) - depth(behind));
        assert!((cut[2].1[1] - share).abs() < 1e-4 && (cut[3].1[1] - share).abs() < 1e-4, "{cut:?}");
        assert!(view.polygon(&[(behind, [0.0; 2]); 3]).is_empty());
    }

    #[test]
    fn odd_points_do_not_panic() {
        for points in [vec![], vec![Vec3::splat(f32::NAN); 3], vec![Vec3::ONE], vec![Vec3::MAX, Vec3::MIN]] {
            let view = Viewpoint::fitted(&points, Vec3::ZERO, Vec3::ZERO, (10, 10), 40.0);
            view.project(Vec3::ONE);
            view.segment(Vec3::ONE, Vec3::ZERO);
            view.polygon(&[]);
        }
    }
}
