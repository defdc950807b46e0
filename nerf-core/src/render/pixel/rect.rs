//! Rectangles of pixels, and the receiver of finished pixels.

use crate::camera::Camera;
use crate::volume::Pixel;

#[cfg(test)]
mod tests;

/// Rectangle of pixels in an image: columns `x..x + width`, rows `y..y + height`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rect {
    /// Left edge, pixels.
    pub x: u32,
    /// Top edge, pixels.
    pub y: u32,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
}

impl Rect {
    /// Returns the rectangle of a camera's whole image.
    pub fn full(camera: &Camera) -> Self {
        let i = camera.intrinsics();
        Self { x: 0, y: 0, width: i.width, height: i.height }
    }

    /// Whether the rectangle lies inside a `width` × `height` image.
    pub fn fits(&self, width: u32, height: u32) -> bool {
        let inside =
            |start: u32, length: u32, all: u32| start.checked_add(length).is_some_and(|end| end <= all);
        inside(self.x, self.width, width) && inside(self.y, self.height, height)
    }

    /// Iterates over x and y of the rectangle's pixels, row by row.
    pub(in crate::render) fn pixels(self) -> impl Iterator<Item = (u32, u32)> + Clone {
        let columns = self.x..self.x + self.width;
        (self.y..self.y + self.height).flat_map(move |y| columns.clone().map(move |x| (x, y)))
    }

    /// Divides the rectangle into tiles of at most `width` × `height` pixels, row by row; a side of 0 counts as 1.
    ///
    /// The part of a rectangle with x or y above the largest `u32` is left out.
    pub fn tiles(self, width: u32, height: u32) -> impl Iterator<Item = Self> {
        let (right, bottom) = (self.x.saturating_add(self.width), self.y.saturating_add(self.height));
        let starts = |from: u32, end: u32, step: u32| (from..end).step_by(step.max(1) as usize);
        starts(self.y, bottom, height).flat_map(move |y| {
            starts(self.x, right, width).map(move |x| Self {
                x,
                y,
                width: width.max(1).min(right - x),
                height: height.max(1).min(bottom - y),
            })
        })
    }
}

/// Receiver of finished pixels.
pub trait Target {
    /// Receives the pixel at `(x, y)` of the image; called once for each pixel.
    fn put(&mut self, x: u32, y: u32, pixel: &Pixel);
}

impl<F: FnMut(u32, u32, &Pixel)> Target for F {
    fn put(&mut self, x: u32, y: u32, pixel: &Pixel) {
        self(x, y, pixel);
    }
}
