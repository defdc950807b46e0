//! Small formats and training.

use super::{Hard, hard};

const N_ELEMENTARY: &str = "tests/tests/numerics/elementary.rs";
const N_ACTIVATIONS: &str = "tests/tests/numerics/network/activations.rs";
const BLOB_TESTS: &str = "nerf-core/src/blob/tests.rs";
const ORACLE: &str = "tests/tests/laws/oracle.rs";
const FAULTS: &str = "nerf-train/tests/cli/faults.rs";
const TRAIN_GRADIENTS: &str = "nerf-train/src/engine/tests/gradients.rs";
const TRANSFORMS: &str = "nerf-train/src/dataset/tests/transforms.rs";
const N_NETWORK: &str = "tests/tests/numerics/network.rs";
const NETWORK_TESTS: &str = "nerf-core/src/network/tests.rs";
const KERNEL_TESTS: &str = "nerf-core/src/kernels/tests.rs";
const DAMAGE: &str = "tests/tests/laws/blob_damage.rs";
const OUTPUT_TESTS: &str = "nerf-train/src/output/tests.rs";
const TRAIN_IMPORT: &str = "nerf-train/tests/cli/import.rs";
const STOPPING: &str = "nerf-train/tests/cli/stopping.rs";
const TRAINING_LAWS: &str = "nerf-train/tests/laws/training.rs";
const CHECKPOINT_LAWS: &str = "nerf-train/tests/laws/checkpoints.rs";
const CHOICE_LAWS: &str = "nerf-train/tests/laws/choice.rs";
const QUALITY_LAWS: &str = "nerf-train/tests/laws/quality.rs";
const METRICS: &str = "nerf-train/src/report/metrics/tests.rs";
const STORAGE: &str = "nerf-train/tests/cli/storage.rs";
const SWEEPS: &str = "nerf-train/src/sweep/tests.rs";
const SUMMARY: &str = "nerf-train/src/report/summary.rs";
const ENGINE: &str = "nerf-train/src/engine/tests.rs";

pub const FORMATS: &[Hard] = &[
    hard(
        "weights above 65,504 or NaN at export",
        "refused by layer and index",
        &[
            (QUALITY_LAWS, &["a_weight_beyond_f16_is_refused_naming_layer_and_index"]),
            (BLOB_TESTS, &["weights_must_be_as_many_as_parameters_and_finite"]),
            (DAMAGE, &["weights_that_are_not_finite_are_named"]),
        ],
    ),
    hard(
        "f16 subnormals keep their value, are counted and reported",
        "exact",
        &[
            (QUALITY_LAWS, &["weights_that_become_f16_subnormals_are_counted_and_keep_their_nearest_value"]),
            (TRAIN_IMPORT, &["weights_that_become_f16_subnormals_are_counted_in_text_and_summary"]),
            (KERNEL_TESTS, &["every_f16_widens_to_what_half_says"]),
            (NETWORK_TESTS, &["unpacking_is_exact_for_every_finite_half"]),
            (ORACLE, &["numbers_of_16_bits_are_ieee_s"]),
        ],
    ),
    hard(
        "what rounding to f16 costs",
        "dB, in the blob",
        &[(QUALITY_LAWS, &["what_rounding_costs_is_measured_and_written_into_the_blob"])],
    ),
    hard(
        "sums of 512 products of f16 extremes: in f32, in place, in bf16",
        "6e-7 of the magnitudes",
        &[
            (N_NETWORK, &["a_dot_product_of_512_extremes_of_f16"]),
            (NETWORK_TESTS, &["a_512_wide_sum_of_the_largest_halves_is_finite"]),
        ],
    ),
    hard(
        "sigmoid and softplus at ±1e4; ReLU(−0)",
        "1.2e-7, 2e-7; +0",
        &[
            (
                N_ACTIVATIONS,
                &[
                    "sigmoid_at_ten_thousand",
                    "softplus_at_ten_thousand",
                    "relu_of_minus_zero",
                    "what_is_no_number_stays_none",
                ],
            ),
            (N_ELEMENTARY, &["sigmoid_of_everything", "softplus_of_everything"]),
            (ORACLE, &["a_network_of_two_units_is_what_paper_and_pencil_say"]),
        ],
    ),
    hard(
        "PSNR at MSE 0 and of NaN pictures; SSIM of constant ones",
        "inf; NaN; 1",
        &[
            (
                METRICS,
                &[
                    "psnr_of_equal_pictures_is_infinite",
                    "nan_and_mismatched_inputs_give_nan",
                    "ssim_of_constant_pictures_is_one",
                    "differences_of_infinite_psnrs_are_no_nan",
                ],
            ),
            (TRAINING_LAWS, &["a_perfect_picture_has_no_loss_and_needs_no_occupancy"]),
            (SUMMARY, &["a_number_that_becomes_finite_loses_its_note"]),
        ],
    ),
];

pub const TRAINING: &[Hard] = &[
    hard(
        "a rate of 0.1",
        "a message, or a finite blob",
        &[
            (TRAINING_LAWS, &["rates_far_too_high_end_in_a_message_or_a_finite_blob"]),
            (FAULTS, &["what_was_not_learned_and_what_was_started_anew_is_said"]),
            (ENGINE, &["a_step_that_diverges_changes_nothing"]),
            (METRICS, &["no_better_than_the_mean_colour_is_flat"]),
        ],
    ),
    hard(
        "dead density",
        "found, cured, reported",
        &[
            (
                TRAINING_LAWS,
                &[
                    "a_network_that_died_is_started_anew_and_still_reproducible",
                    "a_network_that_stays_dead_is_given_up_with_advice",
                ],
            ),
            (TRAIN_GRADIENTS, &["a_dead_density_is_reported"]),
            (FAULTS, &["what_was_not_learned_and_what_was_started_anew_is_said"]),
        ],
    ),
    hard(
        "one picture, 1×1 pictures, all transparent, duplicate poses",
        "a message, or a finite blob",
        &[
            (TRAINING_LAWS, &["strange_pictures_end_in_a_message_or_a_finite_blob"]),
            (FAULTS, &["odd_but_valid_pictures_end_in_a_blob_or_a_message"]),
        ],
    ),
    hard(
        "a batch larger than the data",
        "draws its pixels again",
        &[(TRAINING_LAWS, &["a_batch_larger_than_the_data_draws_its_pixels_again"])],
    ),
    hard(
        "a corrupt PNG among good ones",
        "named",
        &[
            (FAULTS, &["bad_folders_are_refused_naming_file_and_view"]),
            (TRANSFORMS, &["a_corrupt_picture_is_named"]),
        ],
    ),
    hard(
        "kill −9 at any moment",
        "the undisturbed run's bytes",
        &[
            (OUTPUT_TESTS, &["all_bytes_are_synced_before_the_rename_and_the_folder_after_it"]),
            (STOPPING, &["killed_at_20_random_moments_and_resumed_a_run_gives_the_undisturbed_blob"]),
            (
                CHECKPOINT_LAWS,
                &[
                    "a_run_resumed_at_any_step_gives_the_undisturbed_blob",
                    "interruptions_at_any_moment_change_no_byte",
                ],
            ),
            (
                CHOICE_LAWS,
                &["a_run_that_overfits_says_so_and_exports_its_last_step_however_it_is_interrupted"],
            ),
            (OUTPUT_TESTS, &["a_file_appears_only_on_commit"]),
        ],
    ),
    hard(
        "a full disk, one that turns read-only, a short write",
        "a message; the last checkpoint is whole",
        &[
            (
                STORAGE,
                &[
                    "a_disk_that_fills_up_leaves_nothing_half_written",
                    "a_disk_that_fills_up_in_training_leaves_the_last_checkpoint_and_the_run_goes_on",
                    "a_disk_that_turns_read_only_leaves_the_last_checkpoint_to_go_on_from",
                    "a_short_write_leaves_the_last_checkpoint_and_the_run_goes_on",
                ],
            ),
            (
                FAULTS,
                &[
                    "a_full_device_is_reported_naming_the_file",
                    "places_that_cannot_be_written_are_found_out_before_the_work",
                ],
            ),
        ],
    ),
    hard(
        "a damaged checkpoint, also under a right checksum",
        "refused by file and part",
        &[
            (STOPPING, &["resuming_another_run_or_a_damaged_checkpoint_is_refused"]),
            (
                CHECKPOINT_LAWS,
                &[
                    "every_damage_to_a_checkpoint_is_an_error_naming_the_file",
                    "a_checkpoint_whose_parts_do_not_belong_together_is_refused_naming_the_part",
                ],
            ),
        ],
    ),
    hard(
        "two processes with one output",
        "one wins whole",
        &[
            (
                STORAGE,
                &[
                    "of_two_runs_with_one_output_one_wins_whole",
                    "of_two_pictures_with_one_name_one_wins_whole",
                ],
            ),
            (SWEEPS, &["of_two_sweeps_that_begin_at_once_one_wins_whole"]),
            (OUTPUT_TESTS, &["of_many_writers_of_one_name_one_wins_whole"]),
        ],
    ),
];
