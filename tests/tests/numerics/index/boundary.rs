//! Blobs and the C ABI.

use super::{Hard, hard};

const BLOB_TESTS: &str = "nerf-core/src/blob/tests.rs";
const ABI_CASES: &str = "tests/tests/abi/cases.rs";
const NETWORK_TESTS: &str = "nerf-core/src/network/tests.rs";
const DAMAGE: &str = "tests/tests/laws/blob_damage.rs";
const HEADER: &str = "tests/tests/laws/blob_header.rs";
const SHAPES: &str = "tests/tests/laws/blob_shapes.rs";
const SIZES: &str = "tests/tests/laws/sizes.rs";
const ABI_HOSTILE: &str = "tests/tests/abi/hostile.rs";
const ABI_STRUCT_SIZE: &str = "tests/tests/abi/struct_size.rs";
const ABI_THREADS: &str = "tests/tests/abi/threads.rs";
const ABI_PICTURE: &str = "tests/tests/abi/picture.rs";

pub const BLOBS_AND_ABI: &[Hard] = &[
    hard("every truncation", "typed error", &[(DAMAGE, &["every_truncation_is_an_error"])]),
    hard("every bit flip", "typed error", &[(DAMAGE, &["every_flipped_bit_is_an_error"])]),
    hard(
        "damage behind a right checksum; any bytes at all",
        "typed error, or a blob that draws",
        &[
            (DAMAGE, &["flipped_bits_and_bytes_with_a_right_checksum_never_panic"]),
            (
                HEADER,
                &[
                    "every_byte_and_every_pair_of_bytes_of_the_header_is_checked",
                    "any_bytes_are_refused_or_opened_as_the_header_says",
                    "any_body_behind_a_right_header_is_refused_by_type",
                    "any_end_of_a_right_beginning_is_refused_by_type",
                ],
            ),
        ],
    ),
    hard(
        "lengths that overflow, offsets of 2^64 − 1",
        "typed error",
        &[
            (HEADER, &["every_length_around_a_power_of_two_is_counted_without_wrapping"]),
            (SHAPES, &["lengths_up_to_2_to_the_64_reach_nothing"]),
            (ABI_HOSTILE, &["lengths_that_no_memory_has_are_refused_unread"]),
            (DAMAGE, &["non_canonical_numbers_are_refused"]),
        ],
    ),
    hard(
        "300 layers, width 0",
        "typed error",
        &[
            (SHAPES, &["networks_of_300_layers_of_none_and_of_odd_widths_are_refused"]),
            (NETWORK_TESTS, &["every_architecture_error_is_reached_and_says_what_it_found"]),
        ],
    ),
    hard(
        "a skip to a later layer",
        "typed error",
        &[(SHAPES, &["skips_are_a_flag_that_the_first_layer_has_not"])],
    ),
    hard(
        "an occupancy grid of 2^20 cells a side",
        "typed error",
        &[
            (SHAPES, &["occupancies_of_2_to_the_20_cells_a_side_are_refused_unmeasured"]),
            (BLOB_TESTS, &["occupancies_that_do_not_fit_are_refused"]),
        ],
    ),
    hard("weights that are not finite", "named", &[(DAMAGE, &["weights_that_are_not_finite_are_named"])]),
    hard(
        "trailing bytes, wrong endian, future version",
        "typed error",
        &[
            (DAMAGE, &["headers_are_checked_field_by_field"]),
            (HEADER, &["every_word_of_version_endian_flags_and_reserve_is_what_the_format_says"]),
        ],
    ),
    hard(
        "sizes: parameters, occupancy grid, workspaces up to 2^24 rays",
        "as in 128 bits",
        &[(
            SIZES,
            &[
                "parameters_and_work_of_a_network_are_exact_and_fit_32_bits",
                "bytes_of_an_occupancy_are_exact_or_as_many_as_can_be_counted",
                "lines_hold_their_values_and_saturate",
                "saturated_sizes_can_be_added",
                "workspaces_up_to_the_most_rays_are_those_of_few_times_as_many",
                "a_workspace_of_any_plan_is_enough_and_a_line_less_is_not",
            ],
        )],
    ),
    hard(
        "a workspace of size − 1, misaligned by 1 to 63, canaries around it",
        "status; untouched",
        &[(
            ABI_CASES,
            &["exact_sizes_pass_one_byte_less_fails_and_canaries_live", "misaligned_workspaces_fail"],
        )],
    ),
    hard(
        "NULL in each argument",
        "status; nothing written",
        &[
            (ABI_CASES, &["null_in_each_argument_is_refused"]),
            (ABI_HOSTILE, &["null_in_each_argument_of_the_smaller_functions_is_refused"]),
            (ABI_PICTURE, &["null_misaligned_and_overlapping_memory_is_refused"]),
            (ABI_THREADS, &["queries_are_what_the_rust_renderer_says"]),
        ],
    ),
    hard(
        "structures at odd addresses",
        "status; nothing written",
        &[(ABI_HOSTILE, &["structures_at_odd_addresses_are_refused_unread"])],
    ),
    hard(
        "struct_size too small and too large",
        "status; nothing written",
        &[
            (ABI_CASES, &["structures_of_wrong_size_are_refused_and_larger_ones_need_zeros"]),
            (
                ABI_STRUCT_SIZE,
                &[
                    "structures_of_open_options_of_no_version_s_size_open_nothing",
                    "structures_of_scene_info_of_no_version_s_size_are_not_filled",
                    "structures_of_pace_of_no_version_s_size_measure_and_buy_nothing",
                    "structures_of_choice_of_no_version_s_size_choose_nothing",
                    "structures_of_render_options_of_no_version_s_size_plan_and_choose_nothing",
                    "structures_of_camera_of_no_version_s_size_turn_and_see_nothing",
                ],
            ),
        ],
    ),
    hard(
        "a stride smaller than a row",
        "status; untouched",
        &[(ABI_CASES, &["planes_that_do_not_fit_are_refused"])],
    ),
    hard(
        "a target that overlaps blob, scene or workspace; planes that overlap each other",
        "status, to the last pixel; one of them",
        &[
            (ABI_CASES, &["planes_that_do_not_fit_are_refused"]),
            (
                ABI_HOSTILE,
                &[
                    "overlap_is_found_to_the_last_pixel",
                    "a_scene_s_memory_is_apart_from_its_blob_to_the_last_byte",
                    "planes_in_one_place_hold_one_of_them_and_nothing_else_is_written",
                ],
            ),
        ],
    ),
    hard(
        "a tile outside of the image; 0×0",
        "status; nothing written",
        &[(ABI_CASES, &["rectangles_outside_are_refused_and_empty_ones_write_nothing"])],
    ),
    hard("two threads, one scene", "bit for bit", &[(ABI_THREADS, &["threads_share_a_scene_and_a_picture"])]),
    hard(
        "cancelling; a callback that renders; an injected panic",
        "whole tiles; the scene lives on",
        &[(
            ABI_THREADS,
            &[
                "cancelling_stops_within_one_tile_and_leaves_whole_tiles",
                "callbacks_may_render_in_the_same_workspace",
                "panics_become_a_status_and_the_scene_lives_on",
            ],
        )],
    ),
    hard(
        "every buffer beside a page that nobody may touch, on every tier",
        "no fault, same bits",
        &[
            (
                "tests/tests/laws/fences.rs",
                &[
                    "products_stay_between_the_fences",
                    "products_of_halves_stay_between_the_fences",
                    "paired_layers_stay_between_the_fences",
                    "transposed_paired_weights_stay_between_the_fences",
                    "pairs_are_made_between_the_fences",
                    "encodings_stay_between_the_fences",
                    "networks_stay_between_the_fences",
                    "frames_queries_and_pictures_stay_between_the_fences",
                ],
            ),
            (
                "tests/tests/abi/fences.rs",
                &[
                    "a_byte_beyond_a_fence_is_the_end",
                    "scenes_and_all_that_is_passed_with_them_stay_between_the_fences",
                    "pictures_and_all_that_is_passed_with_them_stay_between_the_fences",
                ],
            ),
        ],
    ),
    hard(
        "frames without end; frames of 2^28 pixels; the format's caps",
        "no growth; each pixel; 2e-5",
        &[
            (
                "tests/tests/allocation/long.rs",
                &["frames_and_openings_without_end_take_no_more_memory_and_change_no_bit"],
            ),
            (
                "tests/tests/abi/large.rs",
                &[
                    "tiles_of_a_frame_of_2_28_pixels_are_its_pixels_one_by_one",
                    "planes_of_more_than_2_32_bytes_have_each_pixel_in_its_place",
                    "frames_beyond_any_memory_are_refused_and_the_longest_row_can_be_begun",
                ],
            ),
            (
                "tests/tests/laws/large.rs",
                &[
                    "sixteen_layers_of_512_are_the_oracle_s_on_every_tier",
                    "a_layer_more_and_a_unit_more_than_the_format_allows_are_refused",
                ],
            ),
        ],
    ),
];
