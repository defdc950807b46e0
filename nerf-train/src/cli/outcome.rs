//! What a training run says in the end.

use super::common::tell;
use crate::fit::finish::Outcome;

/// Says where a run learned nothing.
pub fn tell_flat(outcome: &Outcome) {
    if outcome.flat {
        let views = if outcome.scores.views.is_empty() { "training" } else { "validation" };
        tell(&format!(
            "nothing was learned: a flat colour has {:.2} dB on {views} views; lower --rate, or give it more \
             --steps",
            outcome.flat_psnr_db
        ));
    }
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
