//! report.md: the findings in words and tables.

use super::tables::short_table;
use super::{Findings, SPAN_LOSS_DB, Setting, whole, whole_f32};
use crate::lab::study::{BLOB_LOSS_DB, KNOBS, TRAINED_STEP_LOSS_DB};
use crate::measure::point::{Clock, Origin};
use crate::system::printable;
use nerf_core::blob::MAX_FRONT;
use std::fmt::Write as _;

type Line<'l> = &'l mut dyn FnMut(std::fmt::Arguments<'_>);

pub(super) fn markdown(findings: &Findings<'_, '_, '_>, setting: &Setting<'_>) -> String {
    let mut text = format!("# What accuracy costs in time: {}\n\n", printable::markdown(&setting.blob));
    // Writing into a String cannot fail.
    let mut line = |words: std::fmt::Arguments<'_>| _ = writeln!(text, "{words}\n");
    head(findings, setting, &mut line);
    fronts(findings, &mut line);
    rows(findings, &mut line);
    method(findings, &mut line);
    text
}

/// Passes paragraphs to `line`: data, machine, and the largest speed-ups at a PSNR loss of at most `SPAN_LOSS_DB`.
fn head(findings: &Findings<'_, '_, '_>, setting: &Setting<'_>, line: Line<'_>) {
    let study = findings.study;
    line(format_args!(
        "{} views of {} ({}), over {}; {}, {} threads; the study took {:.0} s.",
        study.views.len(),
        printable::markdown(setting.data),
        setting.split,
        setting.background,
        setting.cpu,
        rayon::current_num_threads(),
        setting.seconds
    ));
    if let Some((span, i)) = findings.span(|_| true) {
        line(format_args!(
            "**The front spans {span:.1}×** from the exact rendering to the cheapest point that loses at most \
             {SPAN_LOSS_DB} dB: {}.",
            study.points[i].label
        ));
    }
    for (what, span) in
        [("at whole size", findings.span(whole)), ("at whole size and in f32", findings.span(whole_f32))]
    {
        if let Some((span, i)) = span {
            line(format_args!("- {what}: {span:.1}×, {}", study.points[i].label));
        }
    }
}

fn fronts(findings: &Findings<'_, '_, '_>, line: Line<'_>) {
    line(format_args!("![front](front.png)"));
    line(format_args!(
        "## The front over time\n\n{}",
        short_table(findings, &findings.front).to_markdown().trim_end()
    ));
    line(format_args!(
        "## The front in the blob\n\nOver multiply-adds, which are the same on every machine, and without what a \
         caller cannot ask a blob for (kernel, size, another occupancy grid). Points that lose more than {BLOB_LOSS_DB} dB are left out, \
         and of those that lose at most {TRAINED_STEP_LOSS_DB} dB all that march at longer steps than the field was trained with. Where there are \
         more than {MAX_FRONT} points, the inner one that adds least goes, again and again: least is the area between it and the \
         staircase of its neighbours, dB times the logarithm of cost.\n\n{}",
        short_table(findings, &findings.blob_front).to_markdown().trim_end()
    ));
    line(format_args!("![both ends of the front](ends.png)"));
}

fn rows(findings: &Findings<'_, '_, '_>, line: Line<'_>) {
    let study = findings.study;
    for (knob, entry) in KNOBS.iter().enumerate() {
        let rows: Vec<usize> = (0..study.points.len())
            .filter(|&i| i < 2 || study.points[i].origin == Origin::Knob(knob))
            .collect();
        let table = short_table(findings, &rows);
        if rows.len() > 2 {
            line(format_args!("## One knob: {}\n\n{}", entry.name, table.to_markdown().trim_end()));
        } else {
            line(format_args!(
                "## One knob: {}\n\nNothing else to try: {}.",
                entry.name,
                why_none(entry.name)
            ));
        }
    }
    let mixed: Vec<usize> =
        (0..study.points.len()).filter(|&i| study.points[i].origin == Origin::Combination).collect();
    line(format_args!("## Combinations\n\n{}", short_table(findings, &mixed).to_markdown().trim_end()));
}

fn method(findings: &Findings<'_, '_, '_>, line: Line<'_>) {
    let study = findings.study;
    line(format_args!("## How it was measured"));
    line(format_args!(
        "- *exact*: every sample inside the scene box{}, no cuts, polynomial encoding, f32 on {}. Against the \
         portable oracle it differs by at most {:.1e} in a square of 16 pixels in the middle of {}.",
        if study.lab.scene.occupancy_required {
            " and its occupancy grid, which is part of the model"
        } else {
            ""
        },
        study.points[0].settings.kernel,
        study.oracle_max,
        printable::markdown(&study.views[0].name)
    ));
    line(format_args!(
        "- *lost*: the exact rendering's PSNR against ground truth less the point's, means over the same views. \
         Below 0 the shortcut is better, as an occupancy grid is that hides what the network makes of empty space. *to \
         exact*, *max error* and *ray distance error* (mean, world units, where the exact picture is solid) are \
         against the exact rendering."
    ));
    let timing: Vec<_> = study.timing.iter().map(|&i| printable::markdown(&study.views[i].name)).collect();
    line(format_args!(
        "- Times are {} for whole frames of {}. In each round all points are rendered \
         view by view in turned order; *s a view* is the median over the rounds, *times faster* the median of \
         the ratios within a round. Slow points (no occupancy grid, or portable instructions) are rendered on these views only; \
         in a scene without an occupancy grid all points are.",
        if study.effort.clock == Clock::Cpu {
            "CPU seconds of all cores together"
        } else {
            "seconds on the clock"
        },
        timing.join(", "),
    ));
    if study.rounds_left_out > 0 {
        line(format_args!(
            "- There was no time for {} of the {} rounds.",
            study.rounds_left_out, study.effort.repeats
        ));
    }
    line(format_args!(
        "- Combinations are chosen from the rows: losses are taken to add, multiply-adds to multiply, and what \
         is then on the front is rendered. With kernels that round, each of them once more."
    ));
}

fn why_none(knob: &str) -> &'static str {
    match knob {
        "samples" => "its rays are marched, and their samples follow from the step",
        "march step" => "its samples lie in bins, not at even steps",
        "weights" => "the f32 weights are not at hand (--source names their file)",
        "occupancy" => "the scene has no occupancy grid, or it is part of the model",
        "file" => {
            "no other occupancy grid was asked for, or the network is empty, and there are no f16 tables to round further"
        }
        _ => "there is no other value on this machine",
    }
}
