//! The encoding and volume rendering.

use super::{Hard, hard};

const N_ENCODING: &str = "tests/tests/numerics/encoding.rs";
const N_ENCODING_LAWS: &str = "tests/tests/numerics/encoding/laws.rs";
const N_DOMAIN: &str = "tests/tests/numerics/encoding/domain.rs";
const N_ELEMENTARY: &str = "tests/tests/numerics/elementary.rs";
const N_VOLUME: &str = "tests/tests/numerics/volume.rs";
const N_VOLUME_LAWS: &str = "tests/tests/numerics/volume/laws.rs";
const N_FRAME: &str = "tests/tests/numerics/frame.rs";
const N_HOSTILE: &str = "tests/tests/numerics/frame/hostile.rs";
const N_GRADIENT: &str = "tests/tests/numerics/gradient.rs";
const N_ACTIVATIONS: &str = "tests/tests/numerics/network/activations.rs";
const ENCODING_TESTS: &str = "nerf-core/src/encoding/sinusoidal/tests.rs";
const MATH_TESTS: &str = "nerf-core/src/math/tests.rs";
const VOLUME_TESTS: &str = "nerf-core/src/volume/tests.rs";
const RENDER_TESTS: &str = "nerf-core/src/render/tests.rs";
const BLOB_TESTS: &str = "nerf-core/src/blob/tests.rs";
const ORACLE: &str = "tests/tests/laws/oracle.rs";
const STUDY: &str = "nerf-train/tests/cli/study.rs";
const TRAIN_GRADIENTS: &str = "nerf-train/src/engine/tests/gradients.rs";
const TRAIN_EXTREMES: &str = "nerf-train/src/engine/tests/extremes.rs";
const TRAIN_VOLUME: &str = "nerf-train/src/engine/tests/volume.rs";

pub const ENCODING: &[Hard] = &[
    hard(
        "16 levels, x to ±1e4, ±0, subnormals, multiples of 2^-k, s = π, at every level",
        "1.2e-7",
        &[
            (
                N_ENCODING,
                &[
                    "sixteen_levels_up_to_1e4_with_pi",
                    "ten_levels_up_to_1e4_with_pi",
                    "sixteen_levels_of_multiples_of_powers_of_two",
                    "sixteen_levels_of_zeros_and_subnormals",
                    "sixteen_levels_of_zeros_and_subnormals_without_pi",
                ],
            ),
            (
                N_ENCODING_LAWS,
                &[
                    "sines_are_odd_and_cosines_even",
                    "sines_and_cosines_lie_on_the_circle",
                    "whole_turns_change_no_bit",
                    "a_level_is_the_first_of_a_multiple",
                    "places_in_a_block_change_no_bit",
                ],
            ),
            (
                ENCODING_TESTS,
                &["sixteen_levels_of_pi_stay_within_1_2e_7_up_to_1e4", "exact_multiples_give_exact_values"],
            ),
            (N_ELEMENTARY, &["sin_of_pi_u_for_every_finite_u", "cos_of_pi_u_for_every_finite_u"]),
        ],
    ),
    hard(
        "s = 1 on its domain",
        "1.2e-7",
        &[
            (N_ENCODING, &["ten_levels_up_to_190_without_pi"]),
            (ENCODING_TESTS, &["scale_one_stays_within_1_2e_7_on_its_domain"]),
        ],
    ),
    hard(
        "what other backends err by: libm, micromath, doubling",
        "a row each",
        &[
            (ENCODING_TESTS, &["other_backends_err_by_their_rows"]),
            (MATH_TESTS, &["doubling_errs_by_its_row"]),
        ],
    ),
    hard(
        "the price of each backend",
        "a row of the study",
        &[(STUDY, &["a_study_reports_its_points_and_writes_a_front"])],
    ),
    hard(
        "coordinates outside of the domain: 1e30, inf, NaN",
        "refused, or density 0",
        &[
            (
                N_DOMAIN,
                &[
                    "boxes_that_leave_the_domain_are_refused",
                    "points_outside_of_the_box_are_not_encoded",
                    "directions_that_are_none_are_refused",
                    "cameras_at_no_place_are_refused",
                ],
            ),
            (BLOB_TESTS, &["boxes_that_leave_the_encoding_s_domain_are_refused"]),
            (RENDER_TESTS, &["query_refuses_lengths_and_ignores_points_outside"]),
        ],
    ),
    hard(
        "never in f16, useless from level 6 up",
        "1.2e-7 on every tier",
        &[(ENCODING_TESTS, &["sixteen_levels_of_pi_stay_within_1_2e_7_up_to_1e4"])],
    ),
];

pub const VOLUME: &[Hard] = &[
    hard(
        "sigma and delta of 0, 1e-30 ... 1e30, inf",
        "2e-7",
        &[
            (N_VOLUME, &["every_size_of_density_and_bin", "every_size_of_density_and_bin_weighs"]),
            (N_VOLUME_LAWS, &["any_bits_make_a_pixel"]),
            (
                VOLUME_TESTS,
                &[
                    "every_size_of_sigma_and_delta_gives_a_finite_pixel",
                    "every_size_of_density_and_edge_composites_to_a_finite_pixel",
                ],
            ),
        ],
    ),
    hard(
        "Σw + T = 1, to 4,096 bins",
        "1e-6",
        &[
            (VOLUME_TESTS, &["weights_plus_final_transmittance_is_one"]),
            (N_ELEMENTARY, &["decay_of_everything", "expm1_of_everything"]),
            (N_VOLUME, &["a_ray_of_4096_random_samples", "a_ray_of_4096_thin_samples"]),
            (N_VOLUME_LAWS, &["weights_and_what_is_left_make_one", "any_ray_is_the_oracle_s"]),
            (N_FRAME, &["frames_of_4096_samples_a_ray", "frames_are_the_sums_of_what_a_query_says"]),
            ("tests/tests/laws/large.rs", &["rays_of_4096_samples_are_the_oracle_s_on_every_tier"]),
        ],
    ),
    hard(
        "tiny sigma delta",
        "1e-6 relative",
        &[
            (N_VOLUME, &["thin_samples_keep_their_precision"]),
            (VOLUME_TESTS, &["thin_samples_keep_their_relative_precision"]),
        ],
    ),
    hard(
        "a wall in any bin; delta = 0; t unsorted or NaN",
        "1e-6; typed error",
        &[
            (
                VOLUME_TESTS,
                &[
                    "an_opaque_wall_hides_what_is_behind_it",
                    "edges_that_do_not_ascend_or_are_no_numbers_are_refused",
                ],
            ),
            (
                N_VOLUME,
                &[
                    "walls_in_the_first_and_the_last_bin",
                    "bins_of_no_width",
                    "edges_that_do_not_ascend_or_are_no_numbers",
                ],
            ),
            (N_VOLUME_LAWS, &["what_is_behind_a_wall_changes_no_bit", "what_is_empty_changes_no_bit"]),
            (ORACLE, &["half_a_wall_in_front_of_a_wall"]),
        ],
    ),
    hard(
        "splitting a bin in two",
        "1e-6",
        &[
            (N_VOLUME, &["splitting_a_bin_in_two"]),
            (N_VOLUME_LAWS, &["splitting_any_bin_changes_nothing"]),
            (VOLUME_TESTS, &["splitting_a_bin_changes_nothing"]),
        ],
    ),
    hard(
        "density +inf is a wall; NaN density or colour is empty and counted",
        "law",
        &[
            (
                N_HOSTILE,
                &[
                    "infinite_densities_are_walls",
                    "densities_that_are_no_numbers_are_empty_and_counted",
                    "colours_that_are_no_numbers_are_black_and_counted",
                    "queries_of_values_beyond_f32",
                ],
            ),
            (N_VOLUME, &["densities_and_colours_that_are_no_numbers"]),
            (VOLUME_TESTS, &["samples_that_are_no_numbers_are_empty"]),
            (RENDER_TESTS, &["samples_that_are_no_numbers_are_counted_the_same_in_every_batch"]),
            (
                "nerf-core/src/render/proposal/tests.rs",
                &["densities_that_are_no_numbers_are_counted_and_never_seen"],
            ),
            ("nerf-core/src/render/picture/tests.rs", &["what_is_no_number_is_black_and_counted"]),
        ],
    ),
    hard(
        "density overflow, forward and back",
        "finite",
        &[
            (N_ELEMENTARY, &["exp_of_everything", "softplus_of_everything"]),
            (
                N_ACTIVATIONS,
                &["activations_keep_to_their_range", "densities_of_every_activation_are_none_or_more"],
            ),
            (MATH_TESTS, &["extremes_are_finite"]),
            (
                TRAIN_EXTREMES,
                &[
                    "densities_are_clamped_forward_and_backward_and_their_slopes_are_finite_differences",
                    "pre_activations_of_ten_thousand_give_finite_gradients_on_every_tier",
                ],
            ),
            (TRAIN_VOLUME, &["extremes_of_sigma_and_delta_stay_finite"]),
            (TRAIN_GRADIENTS, &["opaque_walls_and_huge_bins_stay_finite"]),
        ],
    ),
    hard(
        "empty rays: far, opacity 0, background (no output is a disparity)",
        "law",
        &[
            (N_VOLUME, &["empty_rays"]),
            (
                VOLUME_TESTS,
                &["an_empty_ray_is_background_at_far", "distances_are_far_exactly_up_to_the_epsilon"],
            ),
            (RENDER_TESTS, &["no_density_is_background_at_far_and_no_colour_is_computed"]),
        ],
    ),
    hard(
        "opacity above 1 over white",
        "never",
        &[
            (N_VOLUME, &["white_on_white"]),
            (VOLUME_TESTS, &["the_background_shows_through_by_what_is_not_opaque", "no_backend_makes_light"]),
        ],
    ),
    hard(
        "whole rays of the renderer, against f64's network and sums at its own points",
        "by backend",
        &[
            (N_FRAME, &["colours_of_whole_rays", "distances_of_whole_rays", "medians_of_whole_rays"]),
            (
                N_VOLUME_LAWS,
                &[
                    "mean_distances_are_the_oracle_s",
                    "distances_lie_where_the_ray_does",
                    "more_density_is_more_opacity",
                    "units_of_length_change_no_bit",
                    "the_back_of_a_ray_is_a_background",
                ],
            ),
        ],
    ),
    hard(
        "gradients of all of it",
        "finite differences in f64",
        &[
            (
                N_GRADIENT,
                &[
                    "gradients_of_random_networks",
                    "gradients_of_networks_without_doubtful_units",
                    "gradients_where_no_unit_is_on",
                ],
            ),
            (
                TRAIN_EXTREMES,
                &[
                    "derivatives_of_walls_and_haze_and_4096_samples_are_finite_differences",
                    "gradients_of_walls_and_haze_are_finite_differences_on_every_tier",
                ],
            ),
            (TRAIN_VOLUME, &["derivatives_of_a_ray_are_finite_differences"]),
            (
                TRAIN_GRADIENTS,
                &["fused_gradients_are_finite_differences", "fused_gradients_are_those_of_autodiff"],
            ),
            (
                "nerf-core/src/network/gradient/tests.rs",
                &[
                    "gradients_are_the_oracle_s_on_every_tier",
                    "the_oracle_s_gradient_is_the_limit_of_differences",
                ],
            ),
        ],
    ),
];
