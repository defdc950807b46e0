//! Contraction of unbounded space into a box: distant regions get fewer grid cells and longer bins along a ray.

use super::scene_box::SceneBox;
use crate::camera::Ray;
use crate::simd::Lanes;
use glam::Vec3;

#[cfg(test)]
mod tests;

/// The contraction of a scene: maps all of space into an outer ball, and leaves an inner ball of half the outer ball's
/// radius unchanged.
///
/// `centre` and `radius` are the centre and radius of the inner ball. With `q = (p − centre) / radius` and `r = |q|`, a
/// point `p` maps to `q` if `r <= 1`, else to `(2 − 1/r) q/r`, converted back to world units around the same centre.
/// The scene box is the cube around the outer ball, so that its sides are 4 radii of the inner ball.
///
/// # Source
/// Barron et al. 2022, eq. 10.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contraction {
    cube: SceneBox,
    centre: Vec3,
    radius: f32,
    power: u8,
}

impl Contraction {
    /// Valid values of the power `p`, which sets how the distances between samples grow outside the inner ball
    /// ([`Contraction::distance`]).
    pub const POWERS: [u8; 3] = [1, 2, 4];

    /// Makes the contraction whose scene box is `cube`. `None` unless all sides of `cube` are equal, the inner radius
    /// is 1e-30 to 1e30, and `power` is one of [`Contraction::POWERS`].
    pub fn new(cube: &SceneBox, power: u8) -> Option<Self> {
        let (extent, centre) = (cube.max - cube.min, 0.5 * cube.min + 0.5 * cube.max);
        let (longest, shortest) = (extent.max_element(), extent.min_element());
        // Tolerance for the rounding of corners far from the origin.
        let rounding = 4.0 * f32::EPSILON * cube.min.abs().max(cube.max.abs()).max_element();
        let radius = 0.25 * longest;
        let valid = extent.is_finite()
            && longest - shortest <= rounding
            && radius > rounding
            && (1e-30..=1e30).contains(&radius);
        (valid && Self::POWERS.contains(&power)).then_some(Self { cube: *cube, centre, radius, power })
    }

    /// Returns the scene box of the contraction whose inner ball has this centre and radius, world units.
    #[cfg(feature = "train")]
    pub fn cube(centre: Vec3, radius: f32) -> SceneBox {
        let reach = Vec3::splat(2.0 * radius);
        SceneBox { min: centre - reach, max: centre + reach }
    }

    /// Middle of the inner ball, world units.
    pub fn centre(&self) -> Vec3 {
        self.centre
    }

    /// Radius of the inner ball, world units.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// Power `p` of [`Contraction::distance`], which sets how sample spacing grows outside the inner ball.
    pub fn power(&self) -> u8 {
        self.power
    }

    /// Contracts the world point `p`. The result always lies in the scene box. Coordinates of `p` are first clamped to
    /// 1e8 radii from the centre, and a NaN is replaced by the centre's coordinate.
    #[inline]
    pub fn contract(&self, p: Vec3) -> Vec3 {
        Vec3::from_array(self.contract_lanes(p.to_array()))
    }

    /// Contracts a vector of world points, given as x, y and z, as [`Contraction::contract`] does for one point.
    #[inline(always)]
    pub fn contract_lanes<V: Lanes>(&self, p: [V; 3]) -> [V; 3] {
        let one = V::splat(1.0);
        let mut q = self.in_radii(p);
        let square = q[0].mul(q[0]).add(q[1].mul(q[1])).add(q[2].mul(q[2]));
        // 1/r; a point outside of the inner ball is scaled by (2 − 1/r) / r.
        let inverse = one.div(square.max_of(one).sqrt());
        let shrink = V::splat(2.0).sub(inverse).mul(inverse).mul(V::splat(self.radius));
        // A loop, since a closure would not be compiled for the instruction set of the caller.
        for (axis, x) in q.iter_mut().enumerate() {
            let (low, high) = (V::splat(self.cube.min[axis]), V::splat(self.cube.max[axis]));
            *x = V::splat(self.centre[axis]).add(x.mul(shrink)).max_of(low).min_of(high);
        }
        q
    }

    /// Returns the positions `s` ([`Contraction::distance`]) where `ray` enters and leaves the inner ball, up to a
    /// margin; two equal positions if the ray misses the ball. `ray`: from [`Contraction::centred`].
    #[inline]
    pub(crate) fn kept(&self, ray: &Ray) -> [f32; 2] {
        // The margin is for rounding.
        const INNER: f32 = 0.999;
        let offset = (ray.origin - self.centre) * (1.0 / self.radius);
        let (square, half, apart) = (ray.dir.length_squared(), offset.dot(ray.dir), offset.length_squared());
        // The origin is the ray's nearest point to the centre.
        if apart.is_nan() || apart >= INNER {
            return [0.0; 2];
        }
        let root = Lanes::sqrt(half * half + square * (INNER - apart));
        [-half - root, root - half].map(|s| (s / square).clamp(-1.0, 1.0))
    }

    /// Contracts a vector of points that are known to lie in the inner ball. Cheaper than
    /// [`Contraction::contract_lanes`], with bit-identical results.
    #[inline(always)]
    pub(crate) fn kept_lanes<V: Lanes>(&self, mut p: [V; 3]) -> [V; 3] {
        let (into, radius) = (V::splat(1.0 / self.radius), V::splat(self.radius));
        for (axis, x) in p.iter_mut().enumerate() {
            let centre = V::splat(self.centre[axis]);
            *x = centre.add(x.sub(centre).mul(into).mul(radius));
        }
        p
    }

    /// Converts points to offsets from the centre, in radii, clamped so that their squares are finite; a NaN becomes 0.
    #[inline(always)]
    fn in_radii<V: Lanes>(&self, p: [V; 3]) -> [V; 3] {
        let centre = self.centre.to_array();
        let (into, largest) = (V::splat(1.0 / self.radius), V::splat(FARTHEST));
        let mut q = [V::splat(0.0); 3];
        for axis in 0..3 {
            // A NaN becomes 0.
            let x = p[axis].sub(V::splat(centre[axis])).mul(into);
            let x = V::select(x.equals(x), x, V::splat(0.0));
            q[axis] = x.min_of(largest).max_of(largest.neg());
        }
        q
    }

    /// Transforms `gradient` at the contracted point `p` from contracted space to the world: the transpose of the
    /// contraction's Jacobian times `gradient`.
    #[cfg(feature = "normals")]
    pub fn gradient_in_world(&self, p: Vec3, gradient: Vec3) -> Vec3 {
        let q = (p - self.centre) / self.radius;
        let contracted = Lanes::sqrt(q.length_squared());
        if contracted <= 1.0 {
            return gradient;
        }
        let out = q / contracted;
        // 1/r, since the contracted radius is 2 − 1/r. `FARTHEST` limits r at the surface of the outer ball.
        let inverse = (2.0 - contracted).max(1.0 / FARTHEST);
        let along = out * out.dot(gradient);
        (gradient - along) * (contracted * inverse) + along * (inverse * inverse)
    }

    /// Moves the ray's origin to the ray's point nearest to the centre, or not at all if this point lies behind the
    /// origin. Also returns the distance moved, world units.
    pub fn centred(&self, ray: &Ray) -> (Ray, f32) {
        let start = self.nearest(ray.origin.to_array(), ray.dir.to_array());
        (Ray { origin: ray.at(start), ..*ray }, start)
    }

    /// Distance along each ray, world units, to the ray's nearest point to the centre; 0 if this point is behind the
    /// origin.
    #[inline(always)]
    pub(crate) fn nearest<V: Lanes>(&self, mut origin: [V; 3], dir: [V; 3]) -> V {
        for (axis, x) in origin.iter_mut().enumerate() {
            *x = V::splat(self.centre[axis]).sub(*x).mul(dir[axis]);
        }
        origin[0].add(origin[1]).add(origin[2]).max_of(V::splat(0.0))
    }

    /// Converts `s`, a position along a ray, to a distance in world units. Bins of an unbounded scene have equal widths
    /// in `s`. Position and distance are 0 at the origin that [`Contraction::centred`] gives the ray. The distance is
    /// `s` radii if `|s| <= 1`, else `(1 − (|s| − 1)/p)^−p` radii with the sign of `s`; `p`: [`Contraction::power`].
    ///
    /// If `p` is 1, bins outside the inner ball have equal widths in disparity (1 / distance), and all bins on a ray
    /// through the centre have equal widths in contracted space. If `p` is larger, bins outside the inner ball have
    /// nearly equal widths in the logarithm of distance.
    ///
    /// # Source
    /// Barron et al. 2025, power ladder; deviation: linear up to 1, and extended to negative `s`.
    #[inline]
    pub fn distance(&self, s: f32) -> f32 {
        self.distance_lanes(s)
    }

    /// Converts positions `s` along rays, one per lane, to distances in world units, as [`Contraction::distance`] does.
    #[inline(always)]
    pub fn distance_lanes<V: Lanes>(&self, s: V) -> V {
        let (one, size, least) = (V::splat(1.0), s.abs(), V::splat(1.0 / FARTHEST));
        let per_power = V::splat(1.0 / f32::from(self.power));
        let mut base = one.sub(size.sub(one).mul(per_power)).max_of(least).min_of(one);
        let mut doubled = 1;
        while doubled < self.power {
            base = base.mul(base);
            doubled *= 2;
        }
        let far = one.div(base.max_of(least));
        let size = V::select(one.less(size), far, size).mul(V::splat(self.radius));
        V::select(s.less(V::splat(0.0)), size.neg(), size)
    }

    /// Growth of bins outside the inner ball, on a ray through the centre: length of a bin at the contracted point `p`,
    /// divided by the length of a bin inside the inner ball, both measured in the world. Equals the ratio of the
    /// derivatives of [`Contraction::distance`] at the two bins.
    #[cfg(feature = "train")]
    pub fn step_growth(&self, p: Vec3) -> f32 {
        let contracted = (p - self.centre).length() / self.radius;
        let radii = 1.0 / (2.0 - contracted.max(1.0)).max(1.0 / FARTHEST);
        // With b = 1 − (s − 1)/p: radii = b^−p and d(radii)/ds = b^−(p + 1) = radii^((p + 1)/p).
        radii * self.root(radii)
    }

    /// Returns the point of the world that contracts to `p`: the inverse of [`Contraction::contract`].
    #[cfg(feature = "train")]
    pub fn in_world(&self, p: Vec3) -> Vec3 {
        let q = (p - self.centre) / self.radius;
        let contracted = q.length();
        if contracted <= 1.0 {
            return p;
        }
        let radii = 1.0 / (2.0 - contracted).max(1.0 / FARTHEST);
        self.centre + q * (radii / contracted * self.radius)
    }

    /// Converts a distance along a ray, world units, to a position `s`: the inverse of [`Contraction::distance`]. The
    /// result is finite even for a NaN.
    #[inline]
    pub fn step_at<V: Lanes>(&self, distance: V) -> V {
        let (one, radii) = (V::splat(1.0), distance.div(V::splat(self.radius)));
        let size = radii.abs().min_of(V::splat(FARTHEST));
        let power = V::splat(f32::from(self.power));
        let steps = one.add(power.mul(one.sub(one.div(self.root(size)))));
        let steps = V::select(one.less(size), steps, size);
        V::select(radii.less(V::splat(0.0)), steps.neg(), steps)
    }

    /// Returns `x^(1/p)`; `p`: [`Contraction::power`].
    #[inline(always)]
    fn root<V: Lanes>(&self, mut x: V) -> V {
        let mut halved = self.power;
        while halved > 1 {
            x = x.sqrt();
            halved /= 2;
        }
        x
    }
}

/// Largest distance from the centre along an axis or a ray, in radii; larger distances are clamped to this.
const FARTHEST: f32 = 1e8;
