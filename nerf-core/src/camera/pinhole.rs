//! Rays of several pixels at once.

use super::{Camera, Ray};
use crate::simd::{Lanes, MAX_LANES, Op};

/// [`Camera::ray`] through up to [`MAX_LANES`] points of a camera without lens distortion, bit for bit.
pub(crate) struct PinholeRays<'a> {
    pub camera: &'a Camera,
    /// Image coordinates x and y of the points, pixels.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Intrinsics, Lens, Pose};
    use crate::simd::Isa;
    use crate::testing::noise;
    use glam::Vec3;

    #[test]
    fn several_pixels_have_the_rays_of_each() {
        for seed in 0..50 {
            let r = noise(9, seed);
            let eye = Vec3::new(r[0], r[1], r[2]) * 5.0;
            let target = Vec3::new(r[3], r[4], r[5]);
            let Some(pose) = Pose::look_at(eye, target, Vec3::Z) else { continue };
            let (fx, fy) = (30.0 + 9.0 * r[6], 25.0 + 9.0 * r[7]);
            let intrinsics = Intrinsics { width: 16, height: 16, fx, fy, cx: 8.0 + r[8], cy: 7.5 };
            let camera = Camera::new(intrinsics, Lens::NONE, pose).unwrap();
            for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
                for count in [1, 7, 8, 16] {
                    let across = core::array::from_fn(|i| i as f32 + 0.5);
                    let points: [[f32; MAX_LANES]; 2] = [across, [(seed % 16) as f32 + 0.5; MAX_LANES]];
                    let mut rays = [Ray { origin: Vec3::ZERO, dir: Vec3::X }; MAX_LANES];
                    let to = &mut rays[..count];
                    isa.run(PinholeRays { camera: &camera, points: &points, to });
                    for (i, ray) in rays[..count].iter().enumerate() {
                        let expected = camera.ray(points[0][i], points[1][i]);
                        let bits = |ray: &Ray| ray.dir.to_array().map(f32::to_bits);
                        assert_eq!((bits(ray), ray.origin), (bits(&expected), expected.origin));
                    }
                }
            }
        }
    }
}
