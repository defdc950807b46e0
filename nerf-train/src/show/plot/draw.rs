//! Pieces of a plot.

use super::scale::Scale;
use super::{COLOURS, Drawn, FONT, GREY, MAX_POINTS, Marker};
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::prelude::*;
use std::sync::Once;

/// The line and the dots of a series, in its colour.
pub(super) fn draw_series<DB: DrawingBackend>(
    chart: &mut ChartContext<'_, DB, Cartesian2d<Scale, Scale>>,
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

/// A dashed horizontal line whose pattern tells the references apart.
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

/// Text of `size` pixels line height.
pub(super) fn style(size: f32, colour: RGBColor) -> TextStyle<'static> {
    (FONT, size).into_font().color(&colour)
}

/// Control characters would make an SVG that no viewer opens.
pub(super) fn clean(label: &str) -> String {
    label.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

/// The plotting library measures text even for SVG, so that it needs a font of the name we use.
pub(super) fn register_font() {
    static DONE: Once = Once::new();
    DONE.call_once(|| {
        let font = epaint_default_fonts::UBUNTU_LIGHT;
        // A font that does not parse shows up as an error when text is first measured.
        let _ = plotters::style::register_font(FONT, FontStyle::Normal, font);
    });
}

/// At most about [`MAX_POINTS`] of the points: of each run the lowest and the highest, so that no
/// spike is lost. Points that do not ascend in x are a drawing of their own and stay as they are.
pub(super) fn thinned(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    if points.len() <= MAX_POINTS || points.windows(2).any(|pair| pair[0].0 > pair[1].0) {
        return points;
    }
    let run = points.len().div_ceil(MAX_POINTS / 2);
    let mut kept = Vec::with_capacity(MAX_POINTS + 2);
    kept.push(points[0]);
    for chunk in points.chunks(run) {
        let by_y = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        if let (Some(&low), Some(&high)) = (chunk.iter().min_by(by_y), chunk.iter().max_by(by_y)) {
            kept.extend(if low.0 <= high.0 { [low, high] } else { [high, low] });
        }
    }
    kept.extend(points.last());
    kept
}
