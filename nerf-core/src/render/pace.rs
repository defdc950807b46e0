//! Time of a frame on this host: the measurement that turns a limit in milliseconds into settings.

use super::error::check_memory;
use super::{Rect, RenderError, Renderer};
use crate::blob::{Blob, MAX_FRONT};
use crate::camera::Camera;
use crate::memory::{Line, put};
use crate::plan::{Choice, Plan, Quality};
use crate::volume::Pixel;

#[cfg(test)]
mod tests;

/// Approximate maximum number of rays that sample a view: a few per cent of a small picture's, and enough to fill
/// blocks.
const SAMPLED_RAYS: u64 = 2048;

/// Milliseconds of a frame at each point of a scene's Pareto front, in the front's order.
///
/// Valid for one host, camera and number of threads; [`Pace::measure`] measures it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Milliseconds of a frame by index of the point; infinity if it was not measured.
    pub milliseconds: [f32; MAX_FRONT],
}

impl Pace {
    /// A pace without measurements.
    pub const UNKNOWN: Self = Self { milliseconds: [f32::INFINITY; MAX_FRONT] };

    /// The settings of the blob's Pareto front with the least loss whose measured time is at most `milliseconds`,
    /// and that time; of equal losses, the cheaper.
    ///
    /// If every point takes longer, the fastest, with [`Choice::within`] false. `None` without a front, or if
    /// nothing was measured.
    pub fn within(&self, blob: &Blob<'_>, milliseconds: f32) -> Option<(Choice, f32)> {
        let timed = || {
            let known = |(_, time): &(Choice, f32)| time.is_finite();
            let of = |(index, choice)| Some((choice, *self.milliseconds.get::<usize>(index)?));
            Quality::front(blob).filter_map(of).filter(known)
        };
        // Dearest first: of equal losses the last is the cheapest.
        let least = |a: (Choice, f32), b: (Choice, f32)| if b.0.loss_db <= a.0.loss_db { b } else { a };
        match timed().filter(|(_, time)| *time <= milliseconds).reduce(least) {
            Some((choice, time)) => Some((Choice { within: true, ..choice }, time)),
            None => timed().reduce(|a, b| if b.1 < a.1 { b } else { a }),
        }
    }

    /// Lines of workspace that [`Pace::measure`] needs for frames like `plan`.
    pub fn lines(renderer: &Renderer<'_>, plan: &Plan<'_>) -> usize {
        let points = Quality::front(renderer.blob());
        let lines = points.filter_map(|(_, choice)| {
            Some(renderer.workspace_lines(&plan.at(renderer.blob(), &choice.quality).ok()?))
        });
        lines.max().unwrap_or(0)
    }

    /// Measures what a frame takes on one thread at each point of the scene's front.
    ///
    /// `plan`: the plan of a frame, whose shortcuts are replaced by those of each point. `clock`: microseconds
    /// since any moment, never falling. Every n-th pixel of every n-th row is rendered, about 2,048 of them
    /// over the whole view, since single tiles may be empty. The cheapest point comes first; each is rendered
    /// twice, and the shorter time is taken. Once a frame would take more than `limit_milliseconds`, dearer
    /// points are not measured: for a picture far larger than the sample, the whole measurement takes little
    /// longer than one frame at that limit. A scene without a front has no pace.
    ///
    /// # Errors
    /// [`RenderError::Memory`] on less workspace than [`Pace::lines`] says.
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

/// Steps between sampled pixels, right and down: equal, unless a side is shorter than the step.
fn steps(camera: &Camera) -> (u32, u32) {
    let i = camera.intrinsics();
    let (width, height) = (u64::from(i.width), u64::from(i.height));
    let all = width * height;
    let step = if all > SAMPLED_RAYS { (all / SAMPLED_RAYS).isqrt() + 1 } else { 1 };
    // A side that is shorter than a step has one sample, and the other all the rest.
    let right = if step > height { width.div_ceil(SAMPLED_RAYS) } else { step.min(width) };
    let down = if step > width { height.div_ceil(SAMPLED_RAYS) } else { step.min(height) };
    // Lossless: no more than the sides.
    (right as u32, down as u32)
}

/// Pixels of a camera's image.
fn pixels(camera: &Camera) -> u64 {
    let i = camera.intrinsics();
    u64::from(i.width) * u64::from(i.height)
}
