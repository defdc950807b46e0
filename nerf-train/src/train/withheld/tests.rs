use super::*;
use crate::data::demo;
use crate::model::config::Preset;
use crate::model::engine::BatchRay;

/// Returns the finding for root-mean-square errors of `trained` in the photographs that are trained on, and of
/// `withheld` in the withheld photographs.
fn verdict(trained: f32, withheld: f32) -> WithheldFound {
    let (views, config) = (demo::small(30, 1, 8).train, Preset::Grid.config());
    let mut state = Withheld::of(&views, &config).expect("enough photographs");
    for view in 0..views.len() {
        let error = if state.has(view) { withheld } else { trained };
        // Errors of alternating sign around an offset of 0.1. The offset looks like another exposure and must not
        // count.
        let errors: Vec<(u32, [f32; 3])> =
            (0..100).map(|ray| (ray, [0.1 + if ray % 2 == 0 { error } else { -error }; 3])).collect();
        let batch = Batch { views: vec![view as u32; 100], ..Batch::default() };
        state.add(&batch, 0, [(0, [9.0; 3])].iter());
        state.add(&batch, SUMMED_FROM, errors.iter());
    }
    assert_eq!(state.verdict(TRIAL - 2, &config.optimiser), None);
    state.verdict(TRIAL - 1, &config.optimiser).expect("the trial's last step")
}

#[test]
fn photographs_that_come_out_much_worse_unseen_call_for_more_weight_decay() {
    let given = Preset::Grid.config().optimiser.weight_decay;
    let alike = verdict(0.05, 0.06);
    assert!((alike.gap_db - 1.58).abs() < 0.01 && alike.weight_decay == given, "{alike:?}");
    let apart = verdict(0.05, 0.1);
    assert!((apart.gap_db - 6.02).abs() < 0.01 && apart.weight_decay == 30.0 * given, "{apart:?}");
    let between = verdict(0.05, 0.0785);
    assert!(between.weight_decay > 2.0 * given && between.weight_decay < 20.0 * given, "{between:?}");
    // The gap is unknown if the photographs trained on have no error.
    assert_eq!(verdict(0.0, 0.1).weight_decay, given);
}

#[test]
fn six_photographs_have_no_weight_and_few_photographs_are_all_trained_on() {
    let (views, mut config) = (demo::small(50, 1, 8).train, Preset::Grid.config());
    let state = Withheld::of(&views, &config).expect("enough photographs");
    let mut batch = Batch {
        views: (0..50).collect(),
        rays: vec![BatchRay::default(); 50],
        weights: vec![0.5; 50],
        ..Batch::default()
    };
    state.weigh(&mut batch);
    let zeros: Vec<usize> = (0..50).filter(|&view| batch.weights[view] == 0.0).collect();
    assert_eq!(zeros, [4, 12, 20, 28, 36, 44]);
    assert!(state.is_of(&views) && !state.is_of(&views[1..]));
    assert!(Withheld::of(&views[..23], &config).is_none());
    config.capture.withhold = Withholding::Off;
    assert!(Withheld::of(&views, &config).is_none());
    config.capture.withhold = Withholding::Auto;
    config.optimiser.steps = FEWEST_STEPS - 1;
    assert!(Withheld::of(&views, &config).is_none() && Withheld::is_given_up(0.6));
}
