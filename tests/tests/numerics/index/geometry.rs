//! Geometry and sampling.

use super::{Hard, hard};

const N_GEOMETRY: &str = "tests/tests/numerics/geometry.rs";
const N_CAMERAS: &str = "tests/tests/numerics/cameras.rs";
const N_WALK: &str = "tests/tests/numerics/walk.rs";
const N_SAMPLING: &str = "tests/tests/numerics/sampling.rs";
const N_SAMPLING_LAWS: &str = "tests/tests/numerics/sampling/laws.rs";
const CAMERA_TESTS: &str = "nerf-core/src/camera/tests.rs";
const LENS_TESTS: &str = "nerf-core/src/lens/tests.rs";
const RAY_TESTS: &str = "nerf-core/src/ray/tests.rs";
const SAMPLING_TESTS: &str = "nerf-core/src/sampling/tests.rs";
const IMPORTANCE_TESTS: &str = "nerf-core/src/sampling/importance/tests.rs";
const EFFECT_TESTS: &str = "nerf-core/src/effects/tests.rs";
const BLOB_TESTS: &str = "nerf-core/src/blob/tests.rs";
const ABI_CASES: &str = "tests/tests/abi/cases.rs";
const ABI_EFFECTS: &str = "tests/tests/abi/effects.rs";
const RAYS_TESTS: &str = "nerf-train/src/rays/tests.rs";
const QUALITY_LAWS: &str = "nerf-train/tests/laws/quality.rs";
const TRAIN_EFFECTS: &str = "nerf-train/tests/cli/effects.rs";
const FAULTS: &str = "nerf-train/tests/cli/faults.rs";
const TRANSFORMS: &str = "nerf-train/src/dataset/tests/transforms.rs";

pub const GEOMETRY: &[Hard] = &[
    hard(
        "rays parallel to a face, on a face, on an edge, from inside, missing",
        "1.2e-7 of t",
        &[
            (N_GEOMETRY, &["boxes_are_entered_and_left"]),
            (
                RAY_TESTS,
                &[
                    "a_ray_from_inside_starts_at_near",
                    "a_ray_that_misses_or_looks_away_is_none",
                    "a_ray_on_a_face_or_an_edge_counts_as_inside",
                    "a_corner_touched_is_one_point",
                ],
            ),
        ],
    ),
    hard(
        "1/0 and 0·inf in the slab test; directions of 0, NaN, subnormal, 1e30",
        "1.2e-7 of t",
        &[
            (N_GEOMETRY, &["numbers_of_every_size_in_a_ray"]),
            (
                RAY_TESTS,
                &[
                    "subnormal_and_huge_directions_decide_nothing_by_accident",
                    "rays_and_ranges_that_are_no_numbers_meet_nothing",
                ],
            ),
        ],
    ),
    hard(
        "near ≥ far, near = 0; inverted and flat boxes",
        "typed error",
        &[
            (N_GEOMETRY, &["numbers_of_every_size_in_a_ray"]),
            (RAY_TESTS, &["boxes_that_hold_nothing_are_refused"]),
            (SAMPLING_TESTS, &["ranges_without_bins_are_refused"]),
            (BLOB_TESTS, &["scenes_that_hold_nothing_are_refused"]),
            (FAULTS, &["near_beyond_far_is_refused_naming_both"]),
        ],
    ),
    hard(
        "c2w scaled, sheared, reflected, singular, NaN",
        "1e-3, decided as in f64",
        &[
            (N_CAMERAS, &["poses_are_rotations"]),
            (
                CAMERA_TESTS,
                &[
                    "scaled_sheared_reflected_and_singular_poses_are_refused",
                    "poses_that_are_not_finite_or_too_far_are_refused",
                ],
            ),
            (TRANSFORMS, &["wrong_poses_name_their_view"]),
        ],
    ),
    hard(
        "fx = 0",
        "typed error",
        &[
            (CAMERA_TESTS, &["focal_lengths_that_are_no_positive_numbers_are_refused"]),
            (ABI_CASES, &["settings_outside_their_range_are_refused"]),
        ],
    ),
    hard(
        "images of 1×1 and 1×65,535",
        "2e-7, 5e-7",
        &[
            (N_CAMERAS, &["rays_are_of_unit_length", "rays_point_where_the_pinhole_says"]),
            (
                CAMERA_TESTS,
                &[
                    "images_of_one_pixel_and_of_one_column_have_rays",
                    "every_pixel_of_a_camera_has_a_unit_ray",
                ],
            ),
            ("tests/tests/abi/large.rs", &["images_one_pixel_high_or_wide_are_their_parts"]),
        ],
    ),
    hard(
        "lens distortion without an inverse",
        "2.5e-6, or refused",
        &[
            (
                N_CAMERAS,
                &[
                    "extreme_lenses_are_undone_or_refused",
                    "no_two_pixels_look_the_same_way",
                    "lenses_are_undone",
                    "sound_lenses_are_taken",
                ],
            ),
            (CAMERA_TESTS, &["a_folded_lens_is_refused"]),
            (
                LENS_TESTS,
                &[
                    "a_point_that_no_direction_is_seen_at_has_none",
                    "the_domain_reaches_to_the_fold_and_without_one_to_ten_radii",
                ],
            ),
        ],
    ),
    hard(
        "the occupancy grid through corners, along faces, at 1e6: no cell missed, no endless walk",
        "0 missed; 2 look-ups a bin",
        &[
            (N_WALK, &["bins_are_live_where_their_cell_is", "no_cell_is_missed", "every_walk_ends"]),
            (
                SAMPLING_TESTS,
                &[
                    "a_walk_meets_the_bins_that_asking_at_each_meets",
                    "a_full_occupancy_grid_is_the_closed_box",
                ],
            ),
        ],
    ),
];

pub const SAMPLING: &[Hard] = &[
    hard(
        "weights all 0, a single spike, NaN; u = 0, u → 1",
        "what `draw` promises",
        &[
            (N_SAMPLING, &["samples_of_every_kind_of_weights", "rows_are_ascending_and_inside"]),
            (
                N_SAMPLING_LAWS,
                &[
                    "any_weights_are_drawn_from",
                    "any_row_is_ascending_and_inside",
                    "any_row_has_every_middle",
                ],
            ),
            (
                IMPORTANCE_TESTS,
                &[
                    "without_weights_the_samples_are_even",
                    "what_is_no_weight_counts_as_none_and_no_more_than_all",
                    "a_wall_gets_nearly_every_sample",
                ],
            ),
        ],
    ),
    hard(
        "jitter is per pixel and sample, and stays in its bin",
        "law",
        &[
            (N_SAMPLING_LAWS, &["stretches_of_any_row_tile_the_range"]),
            (
                EFFECT_TESTS,
                &[
                    "samples_lie_in_their_bins_in_order_and_evenly",
                    "a_fraction_of_nearly_one_stays_in_its_bin",
                    "every_pixel_ray_bin_and_seed_has_a_number_of_its_own",
                ],
            ),
            (
                RAYS_TESTS,
                &[
                    "samples_of_training_lie_in_their_bins_and_evenly_over_the_jitter_s_width",
                    "a_sample_lies_where_its_fraction_says_and_without_jitter_in_the_middle",
                    "every_step_ray_and_bin_of_training_has_a_fraction_of_its_own",
                ],
            ),
        ],
    ),
    hard(
        "no jitter unless it is asked for, and never at evaluation",
        "bit for bit",
        &[
            (ABI_EFFECTS, &["effects_in_c_are_those_of_rust_bit_for_bit"]),
            (QUALITY_LAWS, &["what_is_fitted_with_jitter_is_measured_in_the_middle_of_the_bins"]),
            (TRAIN_EFFECTS, &["an_evaluation_and_a_study_take_no_jitter"]),
        ],
    ),
];
