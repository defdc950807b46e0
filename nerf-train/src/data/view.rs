//! One picture with its camera, and the background of the scene.

use nerf_core::camera::Camera;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::HashMap;

#[derive(Clone, Debug)]
pub struct View {
    /// Name in messages: the file's path as the data set writes it, or `images_train[7]`.
    pub name: String,
    /// Camera that took the picture; its intrinsics hold the picture's size.
    pub camera: Camera,
    /// Pixels `[height * width]` from the top left, row by row: straight sRGB and alpha (255 without an alpha channel).
    pub pixels: Vec<[u8; 4]>,
    /// Whether each pixel is trained on and evaluated, in the order of `pixels`; `None`: all pixels are.
    pub mask: Option<Vec<bool>>,
    /// Distance from the camera, world units, within which an unbounded scene is taken as empty. Estimated from the
    /// nearest sparse points in view; 0 if too few are in view.
    pub near: f32,
    /// Sparse points that this view shows; empty if the data set states none.
    pub key_points: Vec<KeyPoint>,
}

/// Position of a sparse point in a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyPoint {
    /// Horizontal position, pixels from the left edge.
    pub x: f32,
    /// Vertical position, pixels from the top edge.
    pub y: f32,
    /// Index into [`Dataset::points`](crate::data::Dataset::points).
    pub point: u32,
}

impl View {
    /// Makes a view without a mask and without key points. `pixels`: `[height * width]`.
    pub fn new(name: String, camera: Camera, pixels: Vec<[u8; 4]>) -> Self {
        Self { name, camera, pixels, mask: None, near: 0.0, key_points: Vec::new() }
    }

    pub fn size(&self) -> (u32, u32) {
        let i = self.camera.intrinsics();
        (i.width, i.height)
    }

    pub fn pixel(&self, x: u32, y: u32) -> Option<[u8; 4]> {
        let (width, height) = self.size();
        let index = y as usize * width as usize + x as usize;
        if x < width && y < height { self.pixels.get(index).copied() } else { None }
    }

    /// Returns a copy of this view with `camera`, of the same picture size, in place of its own camera.
    pub fn seen_from(&self, camera: Camera) -> Self {
        Self { camera, ..self.clone() }
    }

    /// Returns a smaller view that is quicker to evaluate.
    ///
    /// The smaller view has the middle pixel of each block of `step` × `step` pixels (`step` is odd), and a camera with
    /// exactly the rays of these pixels. Along a side shorter than `step`, a block has the largest odd number of pixels
    /// that fits. Incomplete blocks are left out. If `step` ≤ 1 or all middle pixels are masked, returns the view.
    pub fn thinned(&self, step: u32) -> Cow<'_, Self> {
        if step <= 1 {
            return Cow::Borrowed(self);
        }
        let (width, height) = self.size();
        let [right, down] = [width, height].map(|side| step.min(side - 1 + side % 2));
        let camera = self.camera.thinned(right, down);
        let small = camera.intrinsics();
        let middle = |i: u32, step: u32| i * step + step / 2;
        let pixels = (0..small.height)
            .flat_map(|y| (0..small.width).map(move |x| (middle(x, right), middle(y, down))))
            .filter_map(|(x, y)| self.pixel(x, y))
            .collect();
        let kept = |i: u32| mask_at(self, middle(i % small.width, right), middle(i / small.width, down));
        let mask: Option<Vec<bool>> =
            self.mask.as_ref().map(|_| (0..small.width * small.height).map(kept).collect());
        if mask.as_ref().is_some_and(|mask| !mask.contains(&true)) {
            return Cow::Borrowed(self);
        }
        let thin = |key: &KeyPoint| KeyPoint { x: key.x / right as f32, y: key.y / down as f32, ..*key };
        let key_points = self.key_points.iter().map(thin).collect();
        Cow::Owned(Self { name: self.name.clone(), camera, pixels, mask, near: self.near, key_points })
    }

    /// Whether the pixel at `index`, counted row by row, is trained on and evaluated.
    pub fn counts(&self, index: usize) -> bool {
        self.mask.as_ref().is_none_or(|mask| mask.get(index).copied().unwrap_or(false))
    }

    /// Returns the colours at the pixels that are not masked out. `rgb`: an image of this view, `[height * width]`.
    pub fn counted<'p>(&self, rgb: &'p [[f32; 3]]) -> Cow<'p, [[f32; 3]]> {
        match &self.mask {
            Some(mask) => rgb.iter().zip(mask).filter(|(_, kept)| **kept).map(|(rgb, _)| *rgb).collect(),
            None => Cow::Borrowed(rgb),
        }
    }

    pub fn pixel_count(&self) -> u64 {
        let (width, height) = self.size();
        u64::from(width) * u64::from(height)
    }

    /// Whether some pixel is not fully opaque.
    pub fn has_alpha(&self) -> bool {
        self.pixels.iter().any(|p| p[3] < 255)
    }

    /// Returns the picture composited over `background`, `[height * width]`; background and result are display-encoded,
    /// in [0, 1]. The formula is `colour * alpha + background * (1 - alpha)`, as in NeRF's reference code.
    pub fn composite_over(&self, background: [f32; 3]) -> Vec<[f32; 3]> {
        self.pixels.iter().map(|&pixel| over(pixel, background)).collect()
    }
}

fn mask_at(view: &View, x: u32, y: u32) -> bool {
    view.counts(y as usize * view.size().0 as usize + x as usize)
}

/// Composites one straight-alpha pixel over `background`; background and result are display-encoded in [0, 1].
pub fn over(pixel: [u8; 4], background: [f32; 3]) -> [f32; 3] {
    let alpha = f32::from(pixel[3]) / 255.0;
    std::array::from_fn(|c| f32::from(pixel[c]) / 255.0 * alpha + background[c] * (1.0 - alpha))
}

/// Returns the mean sRGB of the pixels that are not masked out, in `[0, 1]`; black if there are none.
pub fn mean_colour(views: &[View]) -> [f32; 3] {
    let (mut sum, mut count) = ([0u64; 3], 0u64);
    for view in views {
        for (_, pixel) in view.pixels.iter().enumerate().filter(|&(i, _)| view.counts(i)) {
            sum.iter_mut().zip(pixel).for_each(|(sum, &c)| *sum += u64::from(c));
            count += 1;
        }
    }
    sum.map(|sum| (sum as f64 / (255 * count.max(1)) as f64) as f32)
}

/// Whether all pixels of all views have the same value, so that there is nothing to learn.
pub fn is_blank(views: &[View]) -> bool {
    let mut pixels = views.iter().flat_map(|view| &view.pixels);
    pixels.next().is_none_or(|first| pixels.all(|pixel| pixel == first))
}

/// Kind of background in the pictures of a scene: transparent, of one colour, or part of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Background {
    /// Some picture has alpha below 255. The background may be chosen freely.
    Alpha,
    /// No picture has alpha below 255, and more than half of the unmasked border pixels have exactly this sRGB colour.
    Constant([u8; 3]),
    /// The background is neither transparent nor of one colour: the pictures show it as part of the scene.
    Unknown,
}

impl Background {
    /// Finds the background of `views`: from their alpha or, if all pixels are opaque, from their border pixels.
    pub fn of(views: &[View]) -> Self {
        if views.iter().any(View::has_alpha) {
            return Self::Alpha;
        }
        let mut counts: HashMap<[u8; 3], u64> = HashMap::new();
        let mut total = 0u64;
        for view in views {
            let (width, height) = view.size();
            for y in 0..height {
                let is_whole = y == 0 || y + 1 == height;
                for x in (0..width).step_by(if is_whole { 1 } else { (width as usize - 1).max(1) }) {
                    let index = (y * width + x) as usize;
                    if view.counts(index) {
                        let [r, g, b, _] = view.pixels[index];
                        *counts.entry([r, g, b]).or_default() += 1;
                        total += 1;
                    }
                }
            }
        }
        // Only one colour can have more than half of the pixels, so the order of the map does not matter.
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

#[cfg(test)]
mod tests {
    use crate::data::demo;

    #[test]
    fn a_thinned_view_has_pixels_and_rays_of_the_whole_one() {
        let whole = &demo::small(2, 1, 20).val[0];
        assert!(whole.thinned(1).pixels == whole.pixels);
        for (step, side) in [(3, 6), (5, 4), (19, 1), (21, 1), (65_535, 1)] {
            let thin = whole.thinned(step);
            assert_eq!((thin.size(), thin.pixels.len()), ((side, side), (side * side) as usize));
            let step = step.min(19);
            for i in [0, side - 1] {
                let at = step * i + step / 2;
                assert_eq!(thin.pixel(i, i), whole.pixel(at, at));
                let (a, b) = (
                    thin.camera.ray(i as f32 + 0.5, 0.5),
                    whole.camera.ray(at as f32 + 0.5, (step / 2) as f32 + 0.5),
                );
                assert!((a.dir - b.dir).length() < 1e-6 && a.origin == b.origin);
            }
        }
        assert_eq!(demo::small(2, 1, 2).val[0].thinned(3).size(), (2, 2));
    }
}
