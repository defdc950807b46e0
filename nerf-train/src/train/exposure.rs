//! Exposure gains of the photographs, learned with the field.

use crate::capture::exposure::{CALLED_FOR, LogGains};
use crate::capture::sights::Sights;
use crate::data::View;
use crate::model::config::Exposure;
use crate::train::photographs::SmallAdam;
use serde::{Deserialize, Serialize};

/// Number of steps for which gains are learned on trial. Afterwards, they are kept only if the exposures differ enough.
const TRIAL: u32 = 1_000;
/// Learning rates of the log gains: first, while the gains are on trial; second, otherwise.
const RATES: [f32; 2] = [5e-3, 1e-3];

/// Exposure gains of the training photographs relative to their mean exposure, which is the exposure of the field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gains {
    log: LogGains,
    moment1: Vec<[f32; 3]>,
    moment2: Vec<[f32; 3]>,
    steps: u32,
    on_trial: bool,
    /// Whether the photographs' exposure gains are kept even if they are almost equal: if the user asks, or if held-out
    /// photographs showed that the photographs contradict each other.
    own: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExposureFound {
    /// Standard deviation, over the photographs, of the natural logarithm of the gain.
    pub spread: f64,
    /// Whether the gains were measured at key points; otherwise they were learned with the field for `TRIAL` steps.
    pub by_tracks: bool,
    /// Whether the run continues with a learned gain for each photograph; otherwise with one exposure for all.
    pub fitted: bool,
    /// Index and log gain of the photograph with the largest |log gain|; `None` if |log gain| is below ln 2.
    pub outlier: Option<(u32, f32)>,
}

impl ExposureFound {
    fn of(log: &LogGains, by_tracks: bool, own: bool) -> Self {
        let (spread, outlier) = (log.spread(), log.outlier());
        let fitted = own || spread >= CALLED_FOR || outlier.is_some();
        Self { spread, by_tracks, fitted, outlier }
    }

    /// Returns a message about the spread of exposures and the outlier, if any. `views`: the training photographs.
    pub fn in_words(&self, views: &[View]) -> String {
        let by = if self.by_tracks { "key points" } else { "the first steps" };
        let percent = 100.0 * (self.spread.exp() - 1.0);
        let gains = if self.fitted { "each has a gain of its own" } else { "one exposure for all" };
        let mut words = format!(
            "exposure differs by {percent:.0} % between photographs (standard deviation, by {by}): {gains}"
        );
        if let Some((view, log)) = self.outlier
            && let Some(view) = views.get(view as usize)
        {
            let times = log.abs().exp();
            let side = if log < 0.0 { "darker" } else { "brighter" };
            words += &format!("; {} is {times:.1} times {side} than their mean", view.name);
        }
        words
    }
}

impl Gains {
    /// Returns the gains to learn, and the finding from gains measured at key points. The gains are `None` if all
    /// photographs share one exposure. The finding is `None` if no gains were measured.
    pub fn of(
        views: &[View],
        sights: Option<&Sights>,
        exposure: Exposure,
    ) -> (Option<Self>, Option<ExposureFound>) {
        if exposure == Exposure::Shared || views.len() < 2 {
            return (None, None);
        }
        let own = exposure == Exposure::Own;
        match sights.and_then(|sights| LogGains::measured(views, sights)) {
            Some(log) => {
                let found = ExposureFound::of(&log, true, own);
                (found.fitted.then(|| Self { on_trial: false, ..Self::begin(log, own) }), Some(found))
            }
            None => (Some(Self::begin(LogGains::none(views.len()), own)), None),
        }
    }

    pub fn of_contradicting(views: &[View]) -> Self {
        Self::begin(LogGains::none(views.len()), true)
    }

    fn begin(log: LogGains, own: bool) -> Self {
        let zeros = vec![[0.0; 3]; log.0.len()];
        Self { log, moment1: zeros.clone(), moment2: zeros, steps: 0, on_trial: true, own }
    }

    /// Fills `factors` with the gain of each ray in red, green and blue. `views`: index of each ray's photograph.
    pub fn factors(&self, views: &[u32], factors: &mut Vec<[f32; 3]>) {
        let of_view: Vec<[f32; 3]> = self.log.0.iter().map(|log| log.map(f32::exp)).collect();
        factors.clear();
        factors.extend(views.iter().map(|&view| of_view[view as usize]));
    }

    /// Does one Adam step. `gradients`: gradients of the loss with respect to each photograph's log gains. Returns a
    /// finding after the trial's last step, else `None`. If the finding's `fitted` is false, the caller must discard
    /// the gains.
    pub fn step(&mut self, gradients: &[[f32; 3]]) -> Option<ExposureFound> {
        self.steps += 1;
        let rate = RATES[usize::from(!self.on_trial)];
        let adam = SmallAdam::after(self.steps);
        let moments = self.moment1.iter_mut().zip(&mut self.moment2);
        for ((log, gradient), (m1, m2)) in self.log.0.iter_mut().zip(gradients).zip(moments) {
            for channel in 0..3 {
                let g = gradient[channel];
                // A photograph without a ray in the batch keeps its gain.
                if g == 0.0 {
                    continue;
                }
                log[channel] -= adam.step(rate, g, &mut m1[channel], &mut m2[channel]);
            }
        }
        self.log.centre();
        if !(self.on_trial && self.steps == TRIAL) {
            return None;
        }
        self.on_trial = false;
        Some(ExposureFound::of(&self.log, false, self.own))
    }

    pub fn views(&self) -> usize {
        self.log.0.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::demo;

    #[test]
    fn a_photograph_four_stops_too_dark_is_named_and_calls_for_gains() {
        let data = demo::small(3, 1, 8);
        let mut log = LogGains::none(200);
        log.0[1] = [-1.25; 3];
        log.centre();
        let found = ExposureFound::of(&log, true, false);
        assert!(found.spread < CALLED_FOR && found.fitted, "{found:?}");
        let said = found.in_words(&data.train);
        assert!(said.contains(&data.train[1].name) && said.contains("3.5 times darker"), "{said}");
    }
}
