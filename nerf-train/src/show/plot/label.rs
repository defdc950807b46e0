//! Names beside points, none on top of another.

use super::{Drawn, INK, NOTE_SIZE, style};
use crate::show::text;
use plotters::coord::Shift;
use plotters::prelude::*;
use std::ops::Range;

/// Space between a point and its name, pixels.
const GAP: i32 = 8;
/// Longest name, pixels: the rest is left out.
const WIDEST: usize = 330;

#[derive(Clone, Debug)]
pub struct Label {
    /// Cut off where it is long; empty for none.
    pub text: String,
    /// The point, in the units of the axes.
    pub at: (f64, f64),
}

/// A rectangle that is taken: left, top, right, bottom, pixels.
type Taken = [i32; 4];

/// Draws names at points of the drawing, inside of `area`: on the side with room, moved up or down past the
/// names before, with a thin line where one stands far from its point.
pub(super) fn draw<DB: DrawingBackend>(
    root: &DrawingArea<DB, Shift>,
    area: &(Range<i32>, Range<i32>),
    labels: &[(String, (i32, i32))],
) -> Drawn<DB> {
    let height = NOTE_SIZE as i32 + 1;
    let mut taken: Vec<Taken> = labels.iter().map(|(_, (x, y))| [x - 4, y - 4, x + 4, y + 4]).collect();
    for (name, (x, y)) in labels {
        let Some(name) = text::wrap(name, NOTE_SIZE, WIDEST).into_iter().next() else { continue };
        let width = text::width(&name, NOTE_SIZE) as i32;
        let left = if x + GAP + width < area.0.end { x + GAP } else { x - GAP - width };
        let steps = (0..60).flat_map(|step| [step * height / 2, -step * height / 2]);
        let fits = |top: &i32| {
            let own = [left, *top, left + width, top + height];
            let free = |other: &Taken| {
                own[0] >= other[2] || own[2] <= other[0] || own[1] >= other[3] || own[3] <= other[1]
            };
            *top >= area.1.start && top + height <= area.1.end && taken.iter().all(free)
        };
        let Some(top) = steps.map(|step| y - height / 2 + step).find(fits) else { continue };
        taken.push([left, top, left + width, top + height]);
        if (top + height / 2 - y).abs() > height {
            let end = if left > *x { left - 2 } else { left + width + 2 };
            let path = vec![(*x, *y), (end, top + height / 2)];
            root.draw(&PathElement::new(path, RGBColor(190, 190, 190).stroke_width(1)))?;
        }
        root.draw_text(&name, &style(NOTE_SIZE, INK), (left, top))?;
    }
    Ok(())
}
