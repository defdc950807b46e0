//! Line plots as PNG and SVG.

mod draw;

use super::text;
use crate::data::names::count;
use crate::data::pictures::rgb::Picture;
use crate::system::output::write_atomic;
use crate::system::printable;
use anyhow::Context;
pub use draw::Label;
use draw::{clean, dashed, draw_labels, draw_series, register_font, style};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::ops::Range;
use std::path::{Path, PathBuf};

const WIDTH: usize = 1_100;
const HEIGHT: usize = 720;
const SIZE: (u32, u32) = (WIDTH as u32, HEIGHT as u32);
const MARGIN: i32 = 18;
const TITLE_SIZE: f32 = 28.0;
const TEXT_SIZE: f32 = 20.0;
const NOTE_SIZE: f32 = 17.0;
/// Length of the line before a name in the legend, pixels.
const KEY: i32 = 34;
/// Approximate number of ticks of an axis.
const TICKS: usize = 9;
/// Largest magnitude of a plotted value; a limit is needed because the plotting library computes ticks in f64. Points
/// with a larger value are left out. On a logarithmic axis, points with x below `1 / LARGEST` are left out, too.
const LARGEST: f64 = 1e15;
/// Font family that every SVG viewer has; in PNGs this name refers to the compiled-in font.
const FONT: &str = "sans-serif";
const INK: RGBColor = RGBColor(30, 30, 30);
const GREY: RGBColor = RGBColor(90, 90, 90);

/// Colours that the colour-blind can tell apart. The source's yellow is left out, because yellow vanishes on white.
/// Source: Okabe and Ito 2008, "Color universal design".
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marker {
    /// A line through the points in their order; a lone point becomes a dot.
    Line,
    Points,
    LineAndPoints,
}

#[derive(Clone, Debug)]
pub struct Series {
    pub name: String,
    /// (x, y) in the units of the axes. Points that are not finite, or above `LARGEST` in magnitude, are left out.
    pub points: Vec<(f64, f64)>,
    pub marker: Marker,
}

/// Dashed horizontal line at a value to compare with.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Name in the legend; if empty, the line is drawn but not in the legend.
    pub label: String,
    /// Value to compare with, in the unit of the vertical axis.
    pub y: f64,
}

/// A plot of series over two labelled axes, with the legend next to the data, never on it.
#[derive(Clone, Debug, Default)]
pub struct LinePlot {
    pub title: String,
    /// Label of the horizontal axis with its unit, for example "training time, s".
    pub x_label: String,
    /// Label of the vertical axis with its unit, for example "validation PSNR, dB".
    pub y_label: String,
    /// Series in the order in which they are drawn; may be empty.
    pub series: Vec<Series>,
    /// Whether the horizontal axis is logarithmic; points with x below 1e-15 are then left out.
    pub log_x: bool,
    /// Dashed horizontal lines; the vertical axis always includes their values.
    pub references: Vec<Reference>,
    pub labels: Vec<Label>,
    pub notes: Vec<String>,
}

impl LinePlot {
    pub fn new(title: impl Into<String>, x_label: impl Into<String>, y_label: impl Into<String>) -> Self {
        let (title, x_label, y_label): (String, String, String) =
            (title.into(), x_label.into(), y_label.into());
        // Escapes line ends, which names of data sets in a title may contain.
        let title = printable::line(&title).into_owned();
        Self { title, x_label, y_label, ..Self::default() }
    }

    pub fn to_picture(&self) -> anyhow::Result<Picture> {
        let mut bytes = vec![0; 3 * WIDTH * HEIGHT];
        self.draw(BitMapBackend::with_buffer(&mut bytes, SIZE).into_drawing_area())?;
        let rgb = bytes.as_chunks().0.iter().map(|pixel: &[u8; 3]| pixel.map(|c| f32::from(c) / 255.0));
        Picture::new(WIDTH, HEIGHT, rgb.collect())
    }

    pub fn to_svg(&self) -> anyhow::Result<String> {
        let mut svg = String::new();
        self.draw(SVGBackend::with_string(&mut svg, SIZE).into_drawing_area())?;
        // The library escapes markup in texts, but leaves control characters.
        Ok(printable::lines(&svg).into_owned())
    }

    /// Writes `<stem>.png` and `<stem>.svg`, for example `out/psnr` → `out/psnr.png`. Returns both paths.
    pub fn write(&self, stem: impl AsRef<Path>) -> anyhow::Result<[PathBuf; 2]> {
        let with = |ending: &str| {
            // `with_extension` would cut off the ".1" of a stem such as "psnr_0.1".
            let mut name = stem.as_ref().as_os_str().to_owned();
            name.push(ending);
            PathBuf::from(name)
        };
        let paths = [with(".png"), with(".svg")];
        self.to_picture()?.write_png(&paths[0])?;
        write_atomic(&paths[1], self.to_svg()?.as_bytes())?;
        Ok(paths)
    }

    /// Whether the axes can show the point: |x|, |y| ≤ `LARGEST` and, on a logarithmic axis, x ≥ `1 / LARGEST`.
    fn has_place(&self, (x, y): (f64, f64)) -> bool {
        x.abs() <= LARGEST && y.abs() <= LARGEST && (!self.log_x || x >= 1.0 / LARGEST)
    }

    /// Returns the drawable points of each series, and how many points were left out.
    fn prepared(&self) -> (Vec<Vec<(f64, f64)>>, usize) {
        let mut left_out = 0;
        let prepare = |series: &Series| {
            let mut points = series.points.clone();
            points.retain(|&point| self.has_place(point));
            left_out += series.points.len() - points.len();
            points
        };
        (self.series.iter().map(prepare).collect(), left_out)
    }

    fn draw<DB: DrawingBackend>(&self, root: DrawingArea<DB, Shift>) -> anyhow::Result<()>
    where
        DB::ErrorType: 'static,
    {
        register_font();
        self.draw_on(&root).and_then(|()| root.present()).context("cannot make the plot")
    }

    fn draw_on<DB: DrawingBackend>(&self, root: &DrawingArea<DB, Shift>) -> Drawn<DB> {
        root.fill(&WHITE)?;
        let (points, left_out) = self.prepared();
        let references: Vec<&Reference> =
            self.references.iter().filter(|reference| reference.y.abs() <= LARGEST).collect();
        let top = self.draw_title(root)?;
        let bottom = self.draw_notes(root, left_out, top)?;
        let right = self.draw_legend(root, &references, (top + 8, bottom))?;
        let area = root.clone().shrink((0, top), (right, bottom - top));
        let (xs, ys) = (points.iter().flatten().map(|p| p.0), points.iter().flatten().map(|p| p.1));
        let y = extent(ys.chain(references.iter().map(|reference| reference.y)));
        match self.log_x {
            true => {
                let (range, ticks) = decades(xs);
                let x = range.log_scale().with_key_points(ticks);
                self.draw_chart(root, &area, (x, y), &points, &references)
            }
            false => self.draw_chart(root, &area, (extent(xs), y), &points, &references),
        }
    }

    fn draw_chart<DB: DrawingBackend, X: AsRangedCoord<Value = f64>>(
        &self,
        root: &DrawingArea<DB, Shift>,
        area: &DrawingArea<DB, Shift>,
        (x, y): (X, Range<f64>),
        points: &[Vec<(f64, f64)>],
        references: &[&Reference],
    ) -> Drawn<DB>
    where
        X::CoordDescType: ValueFormatter<f64>,
    {
        let mut chart = ChartBuilder::on(area)
            .margin_left(MARGIN)
            .margin_right(MARGIN)
            .margin_top(10)
            .x_label_area_size(2 * TEXT_SIZE as u32 + 24)
            .y_label_area_size(3 * TEXT_SIZE as u32 + 26)
            .build_cartesian_2d(x, y)?;
        chart
            .configure_mesh()
            .x_labels(TICKS)
            .y_labels(TICKS)
            .max_light_lines(1)
            .x_label_formatter(&tick_label)
            .y_label_formatter(&tick_label)
            .bold_line_style(RGBColor(215, 215, 215))
            .axis_style(GREY)
            .label_style(style(TEXT_SIZE, INK))
            .axis_desc_style(style(TEXT_SIZE, INK))
            .x_desc(clean(&self.x_label))
            .y_desc(clean(&self.y_label))
            .draw()?;
        let (columns, rows) = chart.plotting_area().get_pixel_range();
        for (index, reference) in references.iter().enumerate() {
            // `map_coordinate` returns pixel coordinates of the whole drawing.
            let (_, y) = chart.plotting_area().map_coordinate(&(chart.x_range().start, reference.y));
            dashed(root, (columns.start, y), columns.end, index)?;
        }
        for (index, (series, points)) in self.series.iter().zip(points).enumerate() {
            draw_series(&mut chart, index, series.marker, points)?;
        }
        let labels = self.labels.iter().filter(|label| self.has_place(label.at));
        let placed =
            labels.map(|label| (clean(&label.text), chart.plotting_area().map_coordinate(&label.at)));
        let placed: Vec<_> = placed.collect();
        let middle = ((columns.start + columns.end) / 2, (rows.start + rows.end) / 2);
        draw_labels(root, &(columns, rows), &placed)?;
        if points.iter().all(Vec::is_empty) {
            let centred = style(TITLE_SIZE, GREY).pos(Pos::new(HPos::Center, VPos::Center));
            root.draw_text("no data", &centred, middle)?;
        }
        Ok(())
    }

    /// Draws the title, and returns the first row of pixels below the title.
    fn draw_title<DB: DrawingBackend>(&self, root: &DrawingArea<DB, Shift>) -> Drawn<DB, i32> {
        let mut top = MARGIN;
        for line in text::wrap(&self.title, TITLE_SIZE, WIDTH - 2 * MARGIN as usize).iter().take(3) {
            root.draw_text(line, &style(TITLE_SIZE, INK), (MARGIN, top))?;
            top += TITLE_SIZE as i32 + 2;
        }
        Ok(top)
    }

    /// Draws the notes at the bottom. `left_out`: number of points that the plot leaves out; if it is above 0, a
    /// further note states it. `top`: first row of pixels below the title. Returns the row of pixels at which the space
    /// for the chart ends.
    fn draw_notes<DB: DrawingBackend>(
        &self,
        root: &DrawingArea<DB, Shift>,
        left_out: usize,
        top: i32,
    ) -> Drawn<DB, i32> {
        let widest = WIDTH - 2 * MARGIN as usize;
        let mut lines: Vec<String> =
            self.notes.iter().flat_map(|note| text::wrap(note, NOTE_SIZE, widest)).collect();
        if left_out > 0 {
            let log = if self.log_x { " or not above 0 on a logarithmic axis" } else { "" };
            lines.push(format!("Left out, as not finite{log}: {}.", count(left_out, "point")));
        }
        // Notes never take more than a third of the picture.
        let step = NOTE_SIZE as i32 + 3;
        let most = ((HEIGHT as i32 - top) / 3 / step) as usize;
        if lines.len() > most {
            lines.truncate(most.saturating_sub(1));
            lines.push("…".to_owned());
        }
        let first = HEIGHT as i32 - MARGIN / 2 - step * lines.len() as i32;
        for (i, line) in lines.iter().enumerate() {
            let corner = (MARGIN, first + i as i32 * step);
            root.draw_text(line, &style(NOTE_SIZE, GREY), corner)?;
        }
        Ok(first - if lines.is_empty() { 0 } else { 6 })
    }

    /// Draws the legend at the right edge, between rows `top` and `bottom`. Returns the first column of pixels that the
    /// legend covers; without entries, the picture's width.
    fn draw_legend<DB: DrawingBackend>(
        &self,
        root: &DrawingArea<DB, Shift>,
        references: &[&Reference],
        (top, bottom): (i32, i32),
    ) -> Drawn<DB, i32> {
        let named = self.series.iter().map(|s| s.name.as_str());
        let labelled = references.iter().map(|r| r.label.as_str());
        let widest = WIDTH * 3 / 10 - KEY as usize;
        let entries: Vec<(usize, Vec<String>)> = named
            .chain(labelled)
            .map(|name| text::wrap(name, TEXT_SIZE, widest))
            .enumerate()
            .filter(|(_, lines)| lines.iter().any(|line| !line.is_empty()))
            .collect();
        let lines = || entries.iter().flat_map(|(_, lines)| lines);
        let Some(text_width) = lines().map(|line| text::width(line, TEXT_SIZE)).max() else {
            return Ok(WIDTH as i32);
        };
        // Sans-serif fonts of viewers are up to a tenth wider than the compiled-in one.
        let text_width = (text_width + text_width / 10).max(110) as i32;
        let left = WIDTH as i32 - MARGIN / 2 - text_width - KEY - 8;
        let step = TEXT_SIZE as i32 + 2;
        let mut y = top;
        for (shown, (index, lines)) in entries.iter().enumerate() {
            let rest = entries.len() - shown;
            // If more entries follow, a row stays free for the line that counts the entries without room.
            let needed = lines.len() as i32 * step + if rest > 1 { step } else { 0 };
            if y + needed > bottom && shown > 0 {
                let more = format!("… and {rest} more");
                root.draw_text(&more, &style(TEXT_SIZE, GREY), (left + KEY + 8, y))?;
                break;
            }
            self.draw_key(root, *index, (left, y + TEXT_SIZE as i32 / 2 - 1))?;
            for line in lines {
                root.draw_text(line, &style(TEXT_SIZE, INK), (left + KEY + 8, y))?;
                y += step;
            }
            y += 6;
        }
        Ok(left)
    }

    fn draw_key<DB: DrawingBackend>(
        &self,
        root: &DrawingArea<DB, Shift>,
        index: usize,
        (x, y): (i32, i32),
    ) -> Drawn<DB> {
        let Some(series) = self.series.get(index) else {
            return dashed(root, (x, y), x + KEY, index - self.series.len());
        };
        let colour = COLOURS[index % COLOURS.len()];
        if series.marker != Marker::Points {
            root.draw(&PathElement::new(vec![(x, y), (x + KEY, y)], colour.stroke_width(2)))?;
        }
        if series.marker != Marker::Line {
            root.draw(&Circle::new((x + KEY / 2, y), 4, colour.filled()))?;
        }
        Ok(())
    }
}

/// Returns the ends of a linear axis that holds all values (0 and 1 if there are none), with a margin.
fn extent(values: impl Iterator<Item = f64>) -> Range<f64> {
    let (low, high) = ends(values).unwrap_or((0.0, 1.0));
    let largest = low.abs().max(high.abs());
    let margin = match high - low > 1e-9 * largest {
        true => 0.04 * (high - low),
        false if largest == 0.0 => 0.5,
        false => 0.1 * largest,
    };
    low - margin..high + margin
}

/// Returns the range and the ticks of a logarithmic axis. The range contains all values or, without values, 1 and 10.
/// The ticks are 1, 2 and 5 times powers of ten; if these are more than [`TICKS`], every n-th power of ten.
fn decades(values: impl Iterator<Item = f64>) -> (Range<f64>, Vec<f64>) {
    let (low, high) = ends(values).unwrap_or((1.0, 10.0));
    let exponents = low.log10().floor() as i32..=high.log10().floor() as i32 + 1;
    // A tick is parsed from text, as a power of ten computed by multiplication is not the nearest f64.
    let tick = |exponent: i32, digit: u8| format!("{digit}e{exponent}").parse::<f64>().ok();
    let mut ticks: Vec<f64> = exponents
        .clone()
        .flat_map(|exponent| [1, 2, 5].into_iter().filter_map(move |d| tick(exponent, d)))
        .collect();
    ticks.retain(|&tick| 2.5 * tick > low && tick < 2.5 * high);
    let range = ticks[0]..ticks[ticks.len() - 1];
    if ticks.len() > TICKS {
        let every = 1 + exponents.clone().count() / TICKS;
        ticks = exponents.step_by(every).filter_map(|exponent| tick(exponent, 1)).collect();
        ticks.retain(|tick| (range.start..=range.end).contains(tick));
    }
    (range, ticks)
}

/// Returns the text of a tick's value, to ten digits: rounding errors of sums do not show.
fn tick_label(value: &f64) -> String {
    format!("{value:.9e}").parse().unwrap_or(*value).to_string()
}

fn ends(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    let wider = |(low, high): (f64, f64), value: f64| (low.min(value), high.max(value));
    let ends = values.fold((f64::INFINITY, f64::NEG_INFINITY), wider);
    (ends.0 <= ends.1).then_some(ends)
}

type Drawn<DB, T = ()> = Result<T, DrawingAreaErrorKind<<DB as DrawingBackend>::ErrorType>>;

#[cfg(test)]
mod tests;
