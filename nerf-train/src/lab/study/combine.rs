//! Combinations of several knobs, which are settings that trade accuracy for time. The combinations worth rendering are
//! predicted from measurements of single knobs.

use super::front::{Price, pareto, thin};
use super::knobs::{KNOBS, Knob};
use crate::measure::point::Settings;

/// Values of one knob that differ from the value in the base settings, with their measured losses of PSNR and costs.
#[derive(Clone, Debug, Default)]
pub struct Choices {
    pub knob: usize,
    /// For each value: settings with this value, and loss of PSNR (dB) and ratio of multiply-adds relative to the base.
    pub rows: Vec<(Settings, Price)>,
}

/// Returns up to `most` combinations of two or more knobs, predicted to lie on the Pareto front, most expensive first.
///
/// The prediction adds losses of PSNR and multiplies costs, which is a rough rule. `limit_db`: largest predicted loss
/// against the base. Cost is multiply-adds, not time, so that the choice is the same on every machine.
pub fn combinations(base: Settings, choices: &[Choices], limit_db: f64, most: usize) -> Vec<Settings> {
    let start = (base, Price { loss_db: 0.0, cost: 1.0 });
    let mut all = vec![start];
    for Choices { knob, rows } in choices {
        let knob: &Knob = &KNOBS[*knob];
        let mut next = all.clone();
        for (settings, price) in &all {
            for (row, own) in rows {
                let mut settings = *settings;
                (knob.copy)(row, &mut settings);
                let price = Price { loss_db: price.loss_db + own.loss_db, cost: price.cost * own.cost };
                if price.loss_db <= limit_db {
                    next.push((settings, price));
                }
            }
        }
        all = next;
    }
    let prices: Vec<Price> = all.iter().map(|(_, price)| *price).collect();
    let front = thin(&prices, &pareto(&prices), most);
    // The base and single knobs are measured already.
    front.into_iter().map(|i| all[i].0).filter(|settings| turned(&base, choices, settings) > 1).collect()
}

/// Returns the number of knobs among `choices` whose value in `settings` differs from the value in `base`.
fn turned(base: &Settings, choices: &[Choices], settings: &Settings) -> usize {
    let differs = |choices: &&Choices| {
        let mut copy = *base;
        (KNOBS[choices.knob].copy)(settings, &mut copy);
        copy != *base
    };
    choices.iter().filter(differs).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns choices of the knob `name`. `set`: writes a value into settings. `rows`: value, loss in dB, cost.
    fn choices(name: &str, set: fn(&mut Settings, f32), rows: &[(f32, f64, f64)]) -> Choices {
        let knob = KNOBS.iter().position(|knob| knob.name == name).expect("a knob");
        let row = |&(value, loss_db, cost): &(f32, f64, f64)| {
            let mut settings = Settings::base();
            set(&mut settings, value);
            (settings, Price { loss_db, cost })
        };
        Choices { knob, rows: rows.iter().map(row).collect() }
    }

    #[test]
    fn combinations_turn_several_knobs_within_the_limit() {
        let samples = choices(
            "samples",
            |s, v| s.quality.samples = v as u16,
            &[(48.0, 0.1, 0.75), (32.0, 0.6, 0.5), (16.0, 3.0, 0.25)],
        );
        let cut = choices("transmittance cut", |s, v| s.quality.transmittance_cut = v, &[(0.1, 0.05, 0.8)]);
        let found = combinations(Settings::base(), &[samples.clone(), cut.clone()], 1.0, 10);
        let values: Vec<(u16, f32)> =
            found.iter().map(|s| (s.quality.samples, s.quality.transmittance_cut)).collect();
        // 16 samples would lose more PSNR than the limit, and single knobs are measured already.
        assert_eq!(values, [(48, 0.1), (32, 0.1)]);
        assert!(combinations(Settings::base(), &[samples], 1.0, 10).is_empty());
        assert!(combinations(Settings::base(), &[], 1.0, 10).is_empty());
    }
}
