//! Tables of a study's points: one of all points and measurements, and one of chosen points and main measurements.

use super::Findings;
use crate::lab::study::KNOBS;
use crate::measure::point::{Clock, Origin, Seconds};
use crate::show::table::Table;

pub fn table(findings: &Findings<'_, '_, '_>) -> Table {
    let rows: Vec<_> = (0..findings.study.points.len()).map(|i| row(findings, i)).collect();
    let names = rows.first().into_iter().flatten().map(|(name, _)| *name);
    let mut table = Table::new(names);
    for row in rows {
        table.push(row.into_iter().map(|(_, cell)| cell));
    }
    table
}

/// Returns the cells of the table's row for point `i`, each with the name of its column.
fn row(findings: &Findings<'_, '_, '_>, i: usize) -> Vec<(&'static str, String)> {
    let (point, t, lab) = (&findings.study.points[i], &findings.totals[i], findings.study.lab);
    let origin = match point.origin {
        Origin::Exact => "exact",
        Origin::Base => "base",
        Origin::Knob(knob) => KNOBS[knob].name,
        Origin::Combination => "combination",
    };
    let (wall, cpu) = (point.seconds(Clock::Wall), point.seconds(Clock::Cpu));
    let of = |seconds: Option<Seconds>, which: fn(&Seconds) -> f64| {
        seconds.as_ref().map_or_else(String::new, |seconds| which(seconds).to_string())
    };
    let c = &t.counters;
    let mut row = vec![("origin", origin.to_owned()), ("label", point.label.clone())];
    row.extend(KNOBS.iter().map(|knob| (knob.name, (knob.read)(lab, &point.settings))));
    row.extend([
        ("views", t.views.to_string()),
        ("psnr_db", t.psnr_db.to_string()),
        ("loss_db", t.loss_db.to_string()),
        ("ssim", t.ssim.to_string()),
        ("psnr_to_exact_db", t.exact_psnr_db.to_string()),
        ("max_error_to_exact", t.exact_max.to_string()),
        ("mean_ray_distance_error", t.distance_mean.to_string()),
        ("max_ray_distance_error", t.distance_max.to_string()),
        ("wall_s_median", of(wall, |s| s.median)),
        ("wall_s_low", of(wall, |s| s.low)),
        ("wall_s_high", of(wall, |s| s.high)),
        ("cpu_s_median", of(cpu, |s| s.median)),
        ("cpu_s_low", of(cpu, |s| s.low)),
        ("cpu_s_high", of(cpu, |s| s.high)),
        ("rounds", wall.map_or(0, |s| s.rounds).to_string()),
        ("relative_time", findings.times[i].to_string()),
        ("rays", c.rays.to_string()),
        ("samples_kept", c.samples_kept.to_string()),
        ("samples_skipped", c.samples_skipped.to_string()),
        ("density_evaluations", c.density_evaluations.to_string()),
        ("colour_evaluations", c.colour_evaluations.to_string()),
        ("macs", c.macs.to_string()),
        ("relative_macs", t.relative_macs.to_string()),
        ("invalid_samples", c.invalid_samples.to_string()),
        ("workspace_bytes_a_thread", point.memory.workspace.to_string()),
        ("prepared_bytes", point.memory.prepared.to_string()),
        ("file_bytes", point.memory.file.to_string()),
        ("on_front", findings.front.contains(&i).to_string()),
        ("in_blob", findings.blob_front.contains(&i).to_string()),
    ]);
    row
}

pub fn short_table(findings: &Findings<'_, '_, '_>, which: &[usize]) -> Table {
    const COLUMNS: &str = "# | settings | PSNR, dB | lost, dB | SSIM | to exact, dB | max error | ray distance error | s a view | \
         min – max | times faster | MACs | density/ray | colour/ray | workspace, KiB | file, KiB";
    let mut table = Table::new(COLUMNS.split(" | "));
    for &i in which {
        let (point, t) = (&findings.study.points[i], &findings.totals[i]);
        let seconds = point.seconds(findings.study.effort.clock);
        let rays = t.counters.rays.max(1) as f64;
        let only = findings.study.views.len() - t.views;
        let fewer = if only > 0 { format!(" ({} views)", t.views) } else { String::new() };
        table.push([
            i.to_string(),
            format!("{}{fewer}", point.label),
            format!("{:.3}", t.psnr_db),
            format!("{:.3}", t.loss_db + 0.0),
            format!("{:.4}", t.ssim),
            format!("{:.1}", t.exact_psnr_db),
            format!("{:.3}", t.exact_max),
            if t.distance_mean.is_nan() { "–".into() } else { format!("{:.4}", t.distance_mean) },
            seconds.map_or_else(|| "–".into(), |s| format!("{:.3}", s.median)),
            seconds.map_or_else(|| "–".into(), |s| format!("{:.3} – {:.3}", s.low, s.high)),
            format!("{:.1}", 1.0 / findings.times[i]),
            format!("{:.4}", t.relative_macs),
            format!("{:.2}", t.counters.density_evaluations as f64 / rays),
            format!("{:.2}", t.counters.colour_evaluations as f64 / rays),
            format!("{:.0}", point.memory.workspace as f64 / 1024.0),
            format!("{:.0}", point.memory.file as f64 / 1024.0),
        ]);
    }
    table
}
