//! Silhouettes: whether a view shows any foreground within the projection of an occupancy cell's bounding ball.

use crate::data::{Background, View};
use glam::Vec3;
use nerf_core::camera::Camera;

/// Foreground mask of a view, as a summed-area table.
pub(super) struct Silhouette {
    camera: Camera,
    width: usize,
    height: usize,
    sums: Vec<u32>,
}

impl Silhouette {
    /// Returns the silhouette of a view; `None` if the photographs do not show what is foreground.
    pub(super) fn of(view: &View, background: Background) -> Option<Self> {
        let (width, height) = view.size();
        let (width, height) = (width as usize, height as usize);
        let mut sums = vec![0u32; (width + 1) * (height + 1)];
        for y in 0..height {
            let mut row = 0;
            for x in 0..width {
                let index = y * width + x;
                // A masked pixel counts as foreground, since it may show anything.
                row += u32::from(is_foreground(view.pixels[index], background)? || !view.counts(index));
                sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
            }
        }
        Some(Self { camera: view.camera, width, height, sums })
    }

    /// Whether the view shows foreground within the projection of a ball; `None` if the ball is not completely in view.
    pub(super) fn shows(&self, centre: Vec3, radius: f32) -> Option<bool> {
        let pose = self.camera.pose();
        let local = pose.rotation.transpose() * (centre - pose.position);
        let z = -local.z;
        if z <= 2.0 * radius {
            return None;
        }
        let i = self.camera.intrinsics();
        let (u, v) = self.camera.lens().project(Vec3::new(local.x, -local.y, z))?;
        let (x, y) = (i.cx + i.fx * u, i.cy + i.fy * v);
        // Radius of the ball's projection, pixels. One pixel is added: resampling may have moved the outline that far.
        let reach = radius / (z - radius) * i.fx.max(i.fy) * (1.0 + u * u + v * v).sqrt() + 1.0;
        let (x0, x1, y0, y1) = (x - reach, x + reach, y - reach, y + reach);
        if !(x0 >= 0.0 && y0 >= 0.0 && x1 <= self.width as f32 && y1 <= self.height as f32) {
            return None;
        }
        let (x0, y0, x1, y1) = (x0 as usize, y0 as usize, x1.ceil() as usize, y1.ceil() as usize);
        let at = |x: usize, y: usize| self.sums[y * (self.width + 1) + x];
        Some(at(x1, y1) + at(x0, y0) != at(x0, y1) + at(x1, y0))
    }
}

/// Whether a pixel shows foreground; `None` if the photographs do not show what is foreground.
pub fn is_foreground(pixel: [u8; 4], background: Background) -> Option<bool> {
    match background {
        Background::Alpha => Some(pixel[3] > 0),
        Background::Constant(colour) => Some(pixel[..3] != colour),
        Background::Unknown => None,
    }
}
