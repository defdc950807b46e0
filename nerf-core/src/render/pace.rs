//! Measured times of a frame on this host, for choosing settings that meet a limit in milliseconds.

use super::error::check_memory;
use super::{Rect, RenderError, Renderer};
use crate::blob::{Blob, MAX_FRONT};
use crate::camera::Camera;
use crate::memory::{Line, put};
use crate::plan::{Choice, Plan, Quality};
use crate::volume::Pixel;

#[cfg(test)]
mod tests;

/// Approximate number of pixels rendered to time a frame: a small part of most images, but many blocks of samples.
const SAMPLED_RAYS: u64 = 2048;

/// Measured time of a frame on one thread, for each point of a scene's Pareto front (PSNR against multiply-adds).
///
/// Returned by [`Pace::measure`]. Another host or another camera needs a measurement of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Milliseconds per frame, by the index of the point on the Pareto front; infinity if the point was not measured.
    pub milliseconds: [f32; MAX_FRONT],
}

impl Pace {
    /// No measurements: the time is infinity at every point.
    pub const UNKNOWN: Self = Self { milliseconds: [f32::INFINITY; MAX_FRONT] };

    /// Returns a point of the blob's Pareto front and its measured time: the point of highest PSNR among the points
    /// that take at most `milliseconds`. If several points have this PSNR, returns the cheapest.
    ///
    /// If every point takes longer, returns the fastest point, with [`Choice::within`] false. Returns `None` if the
    /// blob has no Pareto front or no point was measured.
    pub fn within(&self, blob: &Blob<'_>, milliseconds: f32) -> Option<(Choice, f32)> {
        let timed = || {
            let known = |(_, time): &(Choice, f32)| time.is_finite();
            let of = |(index, choice)| Some((choice, *self.milliseconds.get::<usize>(index)?));
            Quality::front(blob).filter_map(of).filter(known)
        };
        // Points come in order of falling cost: of points with equal PSNR the last is the cheapest.
        let least = |a: (Choice, f32), b: (Choice, f32)| if b.0.loss_db <= a.0.loss_db { b } else { a };
        match timed().filter(|(_, time)| *time <= milliseconds).reduce(least) {
            Some((choice, time)) => Some((Choice { within: true, ..choice }, time)),
            None => timed().reduce(|a, b| if b.1 < a.1 { b } else { a }),
        }
    }

    /// Number of 64-byte lines of workspace that [`Pace::measure`] needs for frames of `plan`.
    pub fn lines(renderer: &Renderer<'_>, plan: &Plan<'_>) -> usize {
        let points = Quality::front(renderer.blob());
        let lines = points.filter_map(|(_, choice)| {
            Some(renderer.workspace_lines(&plan.at(renderer.blob(), &choice.quality).ok()?))
        });
        lines.max().unwrap_or(0)
    }

    /// Measures the time of a frame on one thread, with the settings of each point on the scene's Pareto front.
    ///
    /// `plan`: plan of a frame, in which [`Quality`] is replaced by the settings of each point. `clock`: function that
    /// returns microseconds since a fixed moment; the result must never decrease.
    ///
    /// About 2,048 pixels are rendered: every n-th pixel of every n-th row, since the pixels of a single tile may all
    /// show empty space. The time is scaled to the whole frame. Each point is rendered twice, and the shorter time is
    /// used. Points are measured in order of rising cost. Once a point's scaled time exceeds `limit_milliseconds`,
    /// points of higher cost are not measured. A scene without a Pareto front yields [`Pace::UNKNOWN`].
    ///
    /// # Errors
    /// [`RenderError::Memory`] if `workspace` has fewer lines than [`Pace::lines`] returns.
    pub fn measure(
        renderer: &Renderer<'_>,
        plan: &Plan<'_>,
        camera: &Camera,
        limit_milliseconds: f32,
        workspace: &mut [Line],
        clock: &mut impl FnMut() -> u64,
    ) -> Result<Self, RenderError> {
        check_memory(Self::lines(renderer, plan), workspace)?;
        let (right, down) = steps(camera);
        let sample = camera.thinned(right, down);
        let scale = pixels(camera) as f32 / pixels(&sample) as f32;
        let mut pace = Self::UNKNOWN;
        let mut warm = false;
        for index in (0..MAX_FRONT).rev() {
            let Some((_, choice)) = Quality::front(renderer.blob()).find(|(i, _)| *i == index) else {
                continue;
            };
            let Ok(plan) = plan.at(renderer.blob(), &choice.quality) else { continue };
            let mut time = || -> Result<f32, RenderError> {
                let start = clock();
                renderer.render(&plan, &sample, Rect::full(&sample), workspace, &mut |_, _, _: &Pixel| {})?;
                Ok(clock().saturating_sub(start) as f32 / 1000.0 * scale)
            };
            if !core::mem::replace(&mut warm, true) {
                time()?;
            }
            let frame = time()?.min(time()?);
            put(&mut pace.milliseconds, index, frame);
            if frame > limit_milliseconds {
                break;
            }
        }
        Ok(pace)
    }
}

/// Returns the horizontal and vertical step from one timed pixel to the next, pixels. The steps are equal unless a side
/// of the image is shorter than the step: then only one row or column is timed.
fn steps(camera: &Camera) -> (u32, u32) {
    let i = camera.intrinsics();
    let (width, height) = (u64::from(i.width), u64::from(i.height));
    let all = width * height;
    let step = if all > SAMPLED_RAYS { (all / SAMPLED_RAYS).isqrt() + 1 } else { 1 };
    // If a side is shorter than the step, one pixel is timed along it, and all timed pixels lie along the other side.
    let right = if step > height { width.div_ceil(SAMPLED_RAYS) } else { step.min(width) };
    let down = if step > width { height.div_ceil(SAMPLED_RAYS) } else { step.min(height) };
    // Lossless casts: no step is longer than its side.
    (right as u32, down as u32)
}

fn pixels(camera: &Camera) -> u64 {
    let i = camera.intrinsics();
    u64::from(i.width) * u64::from(i.height)
}
