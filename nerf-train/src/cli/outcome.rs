//! What a training run says in the end.

use super::common::{background_name, print_lines, tell};
use crate::fit::direction::ViewDependence;
use crate::fit::finish::Outcome;
use crate::measure::inspect;
use crate::show::reports::fit::count;
use crate::train::moving::in_words;
use nerf_core::blob::Blob;
use std::path::Path;

/// Prints the result.
pub fn print(outcome: &Outcome, output: &Path) -> anyhow::Result<()> {
    print_lines(in_words(&outcome.moved))?;
    print_validation(outcome)?;
    outln!("trained: {} steps in {:.1} s", outcome.steps, outcome.train_seconds);
    if outcome.reseeds > 0 {
        let times = count(outcome.reseeds as usize, "time");
        outln!("started anew {times} with another seed: every density had become 0");
    }
    if !outcome.watched.is_empty() {
        outln!("trend: {}", outcome.trend);
    }
    print_export(outcome)?;
    outln!("blob: {} ({} bytes)", output.display(), outcome.bytes.len());
    Ok(())
}

/// How good it is on unseen views.
fn print_validation(outcome: &Outcome) -> anyhow::Result<()> {
    let background = background_name(outcome.background);
    match (outcome.scores.psnr_db(), outcome.scores.ssim()) {
        (Some(psnr), Some(ssim)) => outln!(
            "validation: {psnr:.2} dB PSNR, {ssim:.4} SSIM over {}{} on {background}; worst view {:.2} dB",
            count(outcome.scores.views.len(), "view"),
            on_lattice(outcome.lattice),
            outcome.scores.worst_psnr_db().unwrap_or(f64::NAN)
        ),
        _ => outln!("validation: no views"),
    }
    if let Some(refined) = &outcome.refined_scores {
        outln!(
            "from their refined poses: {:.2} dB PSNR, {:.4} SSIM; worst view {:.2} dB",
            refined.psnr_db().unwrap_or(f64::NAN),
            refined.ssim().unwrap_or(f64::NAN),
            refined.worst_psnr_db().unwrap_or(f64::NAN)
        );
    }
    if outcome.flat {
        let views = if outcome.scores.views.is_empty() { "training" } else { "validation" };
        outln!(
            "nothing was learned: a flat colour has {:.2} dB on {views} views; lower --rate, or give it more \
             --steps",
            outcome.flat_psnr_db
        );
    }
    Ok(())
}

/// What was decided at export, and what it costs.
fn print_export(outcome: &Outcome) -> anyhow::Result<()> {
    if let Some(loss) = outcome.quantisation_loss_db {
        outln!("rounding cost {loss:.3} dB ({} subnormal weights)", outcome.subnormal_weights);
    }
    if let Some(ViewDependence { gain_db, left_out }) = outcome.view_dependence {
        let what = if left_out { ": left out, its mean is in its place" } else { "" };
        outln!("view dependence gains {gain_db:.3} dB{what}");
    }
    match outcome.occupancy_loss_db {
        Some(loss) if outcome.occupancy_required => {
            outln!("without its occupancy grid the picture changes by {loss:.2} dB: it is part of the model")
        }
        Some(loss) => outln!("without its occupancy grid the picture changes by {loss:.3} dB"),
        None => {}
    }
    if let Some(grid) = Blob::open(&outcome.bytes).ok().and_then(|blob| inspect::describe_grid(&blob)) {
        outln!("learned grid: {grid}");
    }
    Ok(())
}

/// ` (one pixel of 3x3)` where not every pixel was measured.
fn on_lattice(lattice: u32) -> String {
    if lattice == 1 { String::new() } else { format!(" (one pixel of {lattice}x{lattice})") }
}

/// Says of which steps there is no picture though one was asked for.
pub fn tell_missed(outcome: &Outcome) {
    let (last, missed) = (outcome.steps, &outcome.missed_snapshots);
    let (beyond, passed): (Vec<u32>, Vec<u32>) = missed.iter().partition(|&&step| step > last);
    let say = |steps: &[u32], why: String| {
        if !steps.is_empty() {
            let steps: Vec<String> = steps.iter().map(u32::to_string).collect();
            tell(&format!("--snapshots: no picture of step {}: {why}", steps.join(", ")));
        }
    };
    say(&beyond, format!("the run ended at step {last}"));
    say(&passed, "the run had passed it when it was taken up again".into());
}
