//! Drawing of a plot's series, dashed lines and point labels.

use super::{COLOURS, Drawn, FONT, GREY, INK, Marker, NOTE_SIZE};
use crate::show::text;
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::Ranged;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use std::ops::Range;
use std::sync::Once;

/// Draws a series as a line, dots or a line with dots, depending on `marker`. `index` chooses the colour.
pub(super) fn draw_series<DB: DrawingBackend, X: Ranged<ValueType = f64>>(
    chart: &mut ChartContext<'_, DB, Cartesian2d<X, RangedCoordf64>>,
    index: usize,
    marker: Marker,
    points: &[(f64, f64)],
) -> Drawn<DB> {
    let colour = COLOURS[index % COLOURS.len()];
    if marker != Marker::Points && points.len() > 1 {
        chart.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?;
    }
    if marker != Marker::Line || points.len() == 1 {
        chart.draw_series(points.iter().map(|&p| Circle::new(p, 4, colour.filled())))?;
    }
    Ok(())
}

/// Draws a dashed line in row `y`, from column `start` to `end`, pixels. `index` chooses the pattern of dashes.
pub(super) fn dashed<DB: DrawingBackend>(
    root: &DrawingArea<DB, Shift>,
    (start, y): (i32, i32),
    end: i32,
    index: usize,
) -> Drawn<DB> {
    let (dash, gap) = [(10, 5), (3, 4), (18, 4), (6, 10)][index % 4];
    let mut x = start;
    while x < end {
        let stop = (x + dash).min(end);
        root.draw(&PathElement::new(vec![(x, y), (stop, y)], GREY.stroke_width(2)))?;
        x += dash + gap;
    }
    Ok(())
}

pub(super) fn style(size: f32, colour: RGBColor) -> TextStyle<'static> {
    (FONT, size).into_font().color(&colour)
}

/// Replaces control characters by spaces: viewers refuse an SVG that contains them.
pub(super) fn clean(label: &str) -> String {
    label.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// Registers the compiled-in font as [`FONT`]. The plotting library measures text with this font, also for SVG.
pub(super) fn register_font() {
    static DONE: Once = Once::new();
    DONE.call_once(|| {
        let font = epaint_default_fonts::UBUNTU_LIGHT;
        // If the font did not parse, the first measurement of a text would return the error.
        let _ = plotters::style::register_font(FONT, FontStyle::Normal, font);
    });
}

/// Space between a point and its label, pixels.
const GAP: i32 = 8;
/// Width at which a label is cut off, pixels.
const WIDEST: usize = 330;

#[derive(Clone, Debug)]
pub struct Label {
    /// Text of the label, cut off if long; if empty, no label is drawn.
    pub text: String,
    /// Position of the point, in the units of the axes.
    pub at: (f64, f64),
}

/// Rectangle that a point or a label covers: left, top, right, bottom, pixels.
type Taken = [i32; 4];

/// Draws each label beside its point, if there is room, and avoids labelled points and other labels. `labels`: text,
/// and pixel of the point in `root`; `area`: columns and rows for labels. A thin line joins a label to a distant point.
pub(super) fn draw_labels<DB: DrawingBackend>(
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
