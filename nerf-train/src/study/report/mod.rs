//! What a study says: points.csv, report.md, the front as a plot, pictures of its ends, summary.json.

mod markdown;
mod pictures;

use super::error::StudyError;
use super::knobs::KNOBS;
use super::point::{Clock, Origin, Point, Totals};
use super::run::Study;
use crate::output::write_atomic;
use crate::report::plot::{Label, LinePlot, Marker, Reference, Series};
use crate::report::summary::Summary;
use crate::report::table::Table;
use std::path::Path;

/// The loss within which the front's span is told, dB.
pub const SPAN_LOSS_DB: f64 = 1.0;

/// Where and on what a study was made.
#[derive(Clone, Debug)]
pub struct Setting<'a> {
    /// The blob's file.
    pub blob: String,
    /// The data's name.
    pub data: &'a str,
    /// Which part of it.
    pub split: &'a str,
    /// The background's name.
    pub background: String,
    /// The CPU's name.
    pub cpu: String,
    /// Seconds the study took.
    pub seconds: f64,
}

/// Everything of a study in numbers, worked out once.
pub struct Findings<'s, 'a, 'b> {
    /// What was measured.
    pub study: &'s Study<'a, 'b>,
    /// By point.
    pub totals: Vec<Totals>,
    /// Over time.
    pub front: Vec<usize>,
    /// Over multiply-adds, of what a blob can hold.
    pub blob_front: Vec<usize>,
    /// By point: time as a share of the exact rendering's.
    pub times: Vec<f64>,
}

impl<'s, 'a, 'b> Findings<'s, 'a, 'b> {
    /// The findings of a study.
    pub fn of(study: &'s Study<'a, 'b>) -> Self {
        let times = study.times().into_iter().map(|price| price.cost).collect();
        let (totals, front, (blob_front, _)) = (study.totals(), study.front(), study.blob_front());
        Self { study, totals, front, blob_front, times }
    }

    /// How many times faster than the exact rendering the cheapest point within [`SPAN_LOSS_DB`] is, among
    /// those that `keep` says, and which it is.
    pub fn span(&self, keep: impl Fn(&Point) -> bool) -> Option<(f64, usize)> {
        let point = self.study.cheapest(SPAN_LOSS_DB, keep)?;
        Some((1.0 / self.times[point], point))
    }

    /// Every point as a row.
    pub fn table(&self) -> Table {
        let knobs = KNOBS.iter().map(|knob| knob.name);
        let columns = std::iter::once("origin").chain(std::iter::once("label")).chain(knobs).chain([
            "views",
            "psnr_db",
            "loss_db",
            "ssim",
            "psnr_to_exact_db",
            "max_error_to_exact",
            "mean_ray_distance_error",
            "max_ray_distance_error",
            "wall_s_median",
            "wall_s_low",
            "wall_s_high",
            "cpu_s_median",
            "rounds",
            "relative_time",
            "rays",
            "samples_kept",
            "samples_skipped",
            "density_evaluations",
            "colour_evaluations",
            "macs",
            "relative_macs",
            "invalid_samples",
            "workspace_bytes_a_thread",
            "prepared_bytes",
            "on_front",
            "in_blob",
        ]);
        let mut table = Table::new(columns);
        for i in 0..self.study.points.len() {
            table.push(self.row(i));
        }
        table
    }

    fn row(&self, i: usize) -> Vec<String> {
        let (point, t, lab) = (&self.study.points[i], &self.totals[i], self.study.lab);
        let origin = match point.origin {
            Origin::Exact => "exact",
            Origin::Base => "base",
            Origin::Knob(knob) => KNOBS[knob].name,
            Origin::Combination => "combination",
        };
        let mut row = vec![origin.to_owned(), point.label.clone()];
        row.extend(KNOBS.iter().map(|knob| (knob.read)(lab, &point.settings)));
        let wall = point.seconds(Clock::Wall);
        let seconds = |of: fn(&super::point::Seconds) -> f64| {
            wall.as_ref().map_or_else(String::new, |s| of(s).to_string())
        };
        let cpu = point.seconds(Clock::Cpu).map_or_else(String::new, |s| s.median.to_string());
        let c = &t.counters;
        row.extend([
            t.views.to_string(),
            t.psnr_db.to_string(),
            t.loss_db.to_string(),
            t.ssim.to_string(),
            t.exact_psnr_db.to_string(),
            t.exact_max.to_string(),
            t.distance_mean.to_string(),
            t.distance_max.to_string(),
            seconds(|s| s.median),
            seconds(|s| s.low),
            seconds(|s| s.high),
            cpu,
            wall.map_or(0, |s| s.rounds).to_string(),
            self.times[i].to_string(),
        ]);
        row.extend(
            [c.rays, c.samples_kept, c.samples_skipped, c.density_evaluations, c.colour_evaluations, c.macs]
                .map(|count| count.to_string()),
        );
        row.extend([
            t.relative_macs.to_string(),
            c.invalid_samples.to_string(),
            point.memory.workspace.to_string(),
            point.memory.prepared.to_string(),
            self.front.contains(&i).to_string(),
            self.blob_front.contains(&i).to_string(),
        ]);
        row
    }

    /// Some points with what matters most.
    pub fn short_table(&self, which: &[usize]) -> Table {
        let columns = [
            "#",
            "settings",
            "PSNR, dB",
            "lost, dB",
            "SSIM",
            "to exact, dB",
            "max error",
            "ray distance error",
            "s a view",
            "min – max",
            "times faster",
            "MACs",
            "density/ray",
            "colour/ray",
            "workspace, KiB",
        ];
        let mut table = Table::new(columns);
        for &i in which {
            let (point, t) = (&self.study.points[i], &self.totals[i]);
            let seconds = point.seconds(self.study.effort.clock);
            let rays = t.counters.rays.max(1) as f64;
            let only = self.study.views.len() - t.views;
            let fewer = if only > 0 { format!(" ({} views)", t.views) } else { String::new() };
            table.push([
                i.to_string(),
                format!("{}{fewer}", point.label),
                format!("{:.3}", t.psnr_db),
                format!("{:.3}", t.loss_db + 0.0),
                format!("{:.4}", t.ssim),
                format!("{:.1}", t.exact_psnr_db),
                format!("{:.3}", t.exact_max),
                format!("{:.4}", t.distance_mean),
                seconds.map_or_else(|| "–".into(), |s| format!("{:.3}", s.median)),
                seconds.map_or_else(|| "–".into(), |s| format!("{:.3} – {:.3}", s.low, s.high)),
                format!("{:.1}", 1.0 / self.times[i]),
                format!("{:.4}", t.relative_macs),
                format!("{:.2}", t.counters.density_evaluations as f64 / rays),
                format!("{:.2}", t.counters.colour_evaluations as f64 / rays),
                format!("{:.0}", point.memory.workspace as f64 / 1024.0),
            ]);
        }
        table
    }

    /// PSNR over seconds: all points, and the front through its numbered ones.
    fn plot(&self, setting: &Setting<'_>) -> LinePlot {
        let clock = self.study.effort.clock;
        let name = if clock == Clock::Wall { "seconds a view" } else { "CPU seconds a view" };
        let title = format!("{}: what accuracy costs in time", setting.data);
        let mut plot = LinePlot::new(title, name, format!("PSNR, dB, on {}", setting.background));
        let exact = self.study.points[0].seconds(clock).map_or(1.0, |s| s.median);
        // Ratios of the same rounds: points do not move with the machine's load.
        let place = |i: usize| (self.times[i] * exact, self.totals[0].psnr_db - self.totals[i].loss_db);
        let series = |name: &str, which: Vec<usize>, marker| Series {
            name: name.into(),
            points: which.into_iter().map(place).collect(),
            marker,
        };
        let of = |keep: &dyn Fn(&Point) -> bool| {
            (0..self.study.points.len()).filter(|&i| keep(&self.study.points[i])).collect()
        };
        let single = |p: &Point| matches!(p.origin, Origin::Knob(_));
        plot.series = vec![
            series("one knob", of(&single), Marker::Points),
            series("combination", of(&|p| p.origin == Origin::Combination), Marker::Points),
            series("exact", vec![0], Marker::Points),
            series("base", vec![1], Marker::Points),
            series("front", self.front.clone(), Marker::LineAndPoints),
        ];
        plot.log_x = true;
        // Names would cover the points: the front's have the numbers of the tables, and a legend below.
        let label = |text: String, i: usize| Label { text, at: place(i) };
        plot.labels = [0, 1].map(|i| label(self.study.points[i].label.clone(), i)).to_vec();
        let numbered = || self.front.iter().copied().filter(|&i| i > 1);
        plot.labels.extend(numbered().map(|i| label(i.to_string(), i)));
        let named: Vec<String> = numbered().map(|i| format!("{i}: {}", self.study.points[i].label)).collect();
        plot.notes = vec![named.join("; ")];
        plot.references = vec![Reference {
            label: format!("exact less {SPAN_LOSS_DB} dB"),
            y: self.totals[0].psnr_db - SPAN_LOSS_DB,
        }];
        plot
    }

    /// summary.json.
    pub fn summary(&self, setting: &Setting<'_>) -> Summary {
        let study = self.study;
        let mut summary = Summary::new();
        match self.span(|_| true) {
            Some((span, point)) => summary
                .number("front_span_within_1db", span)
                .text("front_span_point", study.points[point].label.clone())
                .number("front_span_loss_db", self.totals[point].loss_db),
            None => summary.absent("front_span_within_1db", "no point within 1 dB"),
        };
        for (name, span) in [
            ("front_span_within_1db_whole_size", self.span(whole)),
            ("front_span_within_1db_whole_size_f32", self.span(whole_f32)),
        ] {
            match span {
                Some((span, _)) => summary.number(name, span),
                None => summary.absent(name, "no such point within 1 dB"),
            };
        }
        let median = |i: usize, clock| study.points[i].seconds(clock).map_or(f64::NAN, |s| s.median);
        summary
            .number("exact_psnr_db", self.totals[0].psnr_db)
            .number("exact_wall_s_a_view", median(0, Clock::Wall))
            .number("exact_cpu_s_a_view", median(0, Clock::Cpu))
            .number("base_psnr_db", self.totals[1].psnr_db)
            .number("base_wall_s_a_view", median(1, Clock::Wall))
            .number("base_span", 1.0 / self.times[1])
            .number("oracle_max_error", study.oracle_max)
            .integer("points", study.points.len() as u64)
            .integer("views", study.views.len() as u64)
            .integer("timing_views", study.timing.len() as u64)
            .integer("timing_rounds_left_out", study.rounds_left_out as u64)
            .text("clock", if study.effort.clock == Clock::Wall { "wall" } else { "cpu" })
            .text("data", setting.data)
            .text("split", setting.split)
            .text("background", setting.background.clone())
            .number("study_seconds", setting.seconds)
            .integer("threads", rayon::current_num_threads() as u64)
            .text("cpu", setting.cpu.clone())
            .sections("front", self.front.iter().map(|&i| self.fields(i)).collect())
            .sections("blob_front", self.blob_front.iter().map(|&i| self.fields(i)).collect());
        summary
    }

    fn fields(&self, i: usize) -> Summary {
        let mut fields = Summary::new();
        fields
            .text("settings", self.study.points[i].label.clone())
            .number("psnr_db", self.totals[i].psnr_db)
            .number("loss_db", self.totals[i].loss_db)
            .number("relative_time", self.times[i])
            .number("relative_macs", self.totals[i].relative_macs);
        fields
    }

    /// Writes everything into `folder`, which exists.
    ///
    /// # Errors
    /// [`StudyError`] on files that cannot be written.
    pub fn write(&self, setting: &Setting<'_>, folder: &Path) -> Result<(), StudyError> {
        self.table().write_csv(folder.join("points.csv"))?;
        self.plot(setting).write(folder.join("front"))?;
        pictures::write(self, folder)?;
        write_atomic(folder.join("report.md"), self.markdown(setting).as_bytes())?;
        self.summary(setting).write(folder)?;
        Ok(())
    }
}

fn whole(point: &Point) -> bool {
    point.settings.quarters == 4
}

fn whole_f32(point: &Point) -> bool {
    whole(point) && !point.settings.tier.rounds()
}
