//! Rays of several pixels at once, for cameras without lens distortion.

use super::{Camera, Ray};
use crate::simd::{Lanes, MAX_LANES, Op};

/// Operation that computes the rays through up to [`MAX_LANES`] image points of `camera`, which must have no lens
/// distortion. The rays are bit-identical to the results of [`Camera::ray`].
pub(crate) struct PinholeRays<'a> {
    pub camera: &'a Camera,
    /// Image points, pixels: every point's x, then every point's y. The ray through point `i` is written to `to[i]`.
    pub points: &'a [[f32; MAX_LANES]; 2],
    pub to: &'a mut [Ray],
}

impl Op for PinholeRays<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let (i, pose) = (self.camera.intrinsics(), self.camera.pose());
        let [right, up, back] = pose.rotation.to_cols_array_2d();
        let [x, y] = self.points;
        let mut dirs = [[0.0; MAX_LANES]; 3];
        for from in (0..self.to.len().min(MAX_LANES)).step_by(V::COUNT) {
            let u = V::load(&x[from..]).sub(V::splat(i.cx)).div(V::splat(i.fx));
            let v = V::load(&y[from..]).sub(V::splat(i.cy)).div(V::splat(i.fy)).neg();
            let mut dir = [u; 3];
            for (axis, dir) in dir.iter_mut().enumerate() {
                let beside = V::splat(right[axis]).mul(u).add(V::splat(up[axis]).mul(v));
                *dir = beside.add(V::splat(-back[axis]));
            }
            let [dx, dy, dz] = dir;
            let length = dx.mul(dx).add(dy.mul(dy)).add(dz.mul(dz)).sqrt();
            let scale = V::splat(1.0).div(length);
            for (to, dir) in dirs.iter_mut().zip(dir) {
                dir.mul(scale).store(&mut to[from..]);
            }
        }
        for (i, ray) in self.to.iter_mut().enumerate().take(MAX_LANES) {
            *ray = Ray { origin: pose.position, dir: dirs.each_ref().map(|dir| dir[i]).into() };
        }
    }
}
