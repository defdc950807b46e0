//! One picture with its camera, and what is behind the scene.

use nerf_core::camera::Camera;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

/// One posed picture.
#[derive(Clone, Debug)]
pub struct View {
    /// What messages call it: the file's path as the data set writes it, or `images_train[7]`.
    pub name: String,
    /// Where it was taken from; its intrinsics hold the picture's size.
    pub camera: Camera,
    /// `[height * width]` from the top left, row by row: straight (not premultiplied) sRGB and
    /// alpha; alpha is 255 where the file has none.
    pub pixels: Vec<[u8; 4]>,
}

impl View {
    /// Width and height, pixels.
    pub fn size(&self) -> (u32, u32) {
        let i = self.camera.intrinsics();
        (i.width, i.height)
    }

    /// The pixel in column `x` and row `y`, or `None` outside of the picture.
    pub fn pixel(&self, x: u32, y: u32) -> Option<[u8; 4]> {
        let (width, height) = self.size();
        let index = y as usize * width as usize + x as usize;
        if x < width && y < height { self.pixels.get(index).copied() } else { None }
    }

    /// Whether some pixel is not fully opaque.
    pub fn has_alpha(&self) -> bool {
        self.pixels.iter().any(|p| p[3] < 255)
    }

    /// The picture over `background`, `[height * width]`, both display-encoded in [0, 1].
    ///
    /// `colour * alpha + background * (1 - alpha)` in display space, as published figures are.
    pub fn composite_over(&self, background: [f32; 3]) -> Vec<[f32; 3]> {
        self.pixels.iter().map(|&pixel| over(pixel, background)).collect()
    }
}

/// One straight-alpha pixel over a display-encoded background, in [0, 1].
pub fn over(pixel: [u8; 4], background: [f32; 3]) -> [f32; 3] {
    let alpha = f32::from(pixel[3]) / 255.0;
    std::array::from_fn(|c| f32::from(pixel[c]) / 255.0 * alpha + background[c] * (1.0 - alpha))
}

/// What is behind the scene in its pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Background {
    /// Some picture has alpha below 255: the background is free to choose.
    Alpha,
    /// No alpha, but more than half of all border pixels are exactly this sRGB colour.
    Constant([u8; 3]),
    /// Neither.
    Unknown,
}

impl Background {
    /// The background of these pictures, from their alpha or else from their borders.
    pub fn of(views: &[View]) -> Self {
        if views.iter().any(View::has_alpha) {
            return Self::Alpha;
        }
        let mut counts: HashMap<[u8; 3], u64> = HashMap::new();
        let mut total = 0u64;
        for view in views {
            let (width, height) = view.size();
            for (index, p) in view.pixels.iter().enumerate() {
                let (x, y) = (index as u32 % width, index as u32 / width);
                if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
                    *counts.entry([p[0], p[1], p[2]]).or_default() += 1;
                    total += 1;
                }
            }
        }
        // More than half can be only one colour, so the order of the map does not matter.
        match counts.into_iter().find(|&(_, count)| 2 * count > total) {
            Some((colour, _)) => Self::Constant(colour),
            None => Self::Unknown,
        }
    }
}

impl std::fmt::Display for Background {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Alpha => f.write_str("transparent"),
            Self::Constant([r, g, b]) => write!(f, "constant sRGB ({r}, {g}, {b})"),
            Self::Unknown => f.write_str("part of the pictures"),
        }
    }
}
