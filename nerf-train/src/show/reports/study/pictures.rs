//! Renderings at both ends of a study's Pareto front, and their differences from ground truth and the exact rendering.

use super::{Findings, SPAN_LOSS_DB};
use crate::data::pictures::rgb::Picture;
use crate::measure::frame;
use crate::show::colour_map::{ColourMap, with_legend};
use crate::show::contact_sheet::{Cell, contact_sheet};
use std::path::Path;

/// Difference of a colour channel (values 0 to 1) that is drawn in the brightest colour of the colour map.
const BRIGHTEST: f32 = 0.25;

/// Renders the first timed view with up to three settings: the slowest and the fastest setting of the Pareto front, and
/// the fastest setting with a loss of at most `SPAN_LOSS_DB`. Writes pictures of the differences from ground truth and
/// from the exact rendering, and the contact sheet `ends.png`.
pub fn write(findings: &Findings<'_, '_, '_>, folder: &Path) -> anyhow::Result<()> {
    let study = findings.study;
    let (Some(&dearest), Some(&last)) = (findings.front.first(), findings.front.last()) else {
        return Ok(());
    };
    let within = study.cheapest(SPAN_LOSS_DB, |_| true).unwrap_or(last);
    let view = study.timing[0];
    let truth = study.views[view].composite_over(study.background);
    let mut ends = vec![(dearest, "dearest"), (within, "within_1db"), (last, "cheapest")];
    ends.dedup_by_key(|(point, _)| *point);
    let settings: Vec<_> = ends.iter().map(|&(i, _)| study.points[i].settings).collect();
    let mut cells = Vec::new();
    study.lab.prepared(&settings, |bench| {
        for (&(i, name), settings) in ends.iter().zip(&settings) {
            let camera = &study.views[view].camera;
            let (frame, ..) = bench.render(settings, camera, study.background)?;
            let (width, height) = (frame.width, frame.height);
            let against = |other: &[[f32; 3]]| -> anyhow::Result<Picture> {
                Picture::new(width, height, difference(&frame.rgb, other))
            };
            let (to_truth, to_exact) = (against(&truth)?, against(&study.exact[view].rgb)?);
            let legend = |picture: &Picture, title: &str| {
                with_legend(picture, ColourMap::Magma, (0.0, BRIGHTEST), title)
            };
            legend(&to_truth, "largest channel's |error|")
                .write_png(folder.join(format!("difference_{name}_truth.png")))?;
            legend(&to_exact, "largest channel's |difference|")
                .write_png(folder.join(format!("difference_{name}_exact.png")))?;
            let totals = &findings.totals[i];
            let caption = format!(
                "{}\n{:.2} dB, {:.1} times faster than exact",
                study.points[i].label,
                totals.psnr_db,
                1.0 / findings.times[i]
            );
            cells.push(Cell::new(frame::picture(&frame), caption));
            cells.push(Cell::new(to_truth, format!("to the truth, 0 to {BRIGHTEST}")));
            cells.push(Cell::new(to_exact, format!("to the exact rendering, 0 to {BRIGHTEST}")));
        }
        Ok(())
    })?;
    let exact = &study.exact[view];
    let picture = |rgb: &[[f32; 3]]| Picture::new(exact.width, exact.height, rgb.to_vec());
    cells.push(Cell::new(picture(&truth)?, "truth"));
    cells.push(Cell::new(picture(&exact.rgb)?, "exact"));
    let title = format!("{}: the ends of the front", study.views[view].name);
    contact_sheet(&title, &cells, 3).write_png(folder.join("ends.png"))?;
    Ok(())
}

fn difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let largest = |(a, b): (&[f32; 3], &[f32; 3])| {
        (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, |most, d| if d > most || d.is_nan() { d } else { most })
    };
    a.iter().zip(b).map(largest).map(|d| ColourMap::Magma.colour(d / BRIGHTEST)).collect()
}
