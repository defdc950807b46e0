//! C ABI of `nerf-core`: renders radiance fields from C and C++.
//!
//! C types and functions that belong together share a file. This crate's README describes the contract in prose;
//! `include/nerf_render.h` is generated from these files. Scenes and workers lie in the caller's memory: nothing here
//! allocates or owns memory, except `scene_file.rs`, which needs the feature `std`.
#![cfg_attr(not(feature = "std"), no_std)]
#![allow(unsafe_code, reason = "this crate is the boundary: it turns C's pointers into slices")]

mod boundary;
mod failure;
#[cfg(all(feature = "panic-handler", not(feature = "std")))]
mod panic_handler;
mod span;
mod tile_pixels;

// The modules below are in the order of the header, which is the order of use.
mod version;

mod status;

mod open_options;

mod scene;

#[cfg(feature = "std")]
mod scene_file;

mod scene_info;

mod camera;

mod effects;

mod render_options;

mod outputs;

mod instance;

mod worker;

mod pixel;

mod target;

mod progress;

mod counters;

mod frame;

mod rays;

mod query;

mod pace;

mod quality;

mod explain;

pub use camera::{Camera, LensModel, nerf_camera_look_at, nerf_camera_ray};
pub use counters::Counters;
pub use effects::{Effects, ToneMap};
pub use explain::nerf_explain;
pub use frame::{Frame, Rect, nerf_render, nerf_render_picture};
pub use instance::Instance;
pub use open_options::{Kernel, OpenOptions, Storage};
pub use outputs::{
    NERF_OUTPUT_MEDIAN_DISTANCE, NERF_OUTPUT_NORMALS, NERF_OUTPUT_OPACITY, NERF_OUTPUT_RAY_DISTANCE,
    NERF_OUTPUT_RGB, NERF_OUTPUT_Z_DEPTH,
};
pub use pace::{Clock, Pace, PaceRequest, nerf_pace_measure, nerf_pace_workspace_size};
pub use pixel::PixelFormat;
pub use progress::Progress;
pub use quality::{
    Choice, Preset, nerf_quality_point, nerf_quality_preset, nerf_quality_within_cost,
    nerf_quality_within_loss, nerf_quality_within_time,
};
pub use query::{Points, nerf_query};
pub use rays::{Floats, Rays, nerf_render_rays, nerf_sample_rays};
pub use render_options::{
    Maths, NERF_COLOUR_CUT_DEFAULT, NERF_NONE, NERF_NORMAL_BLUR_DEFAULT, NERF_TRANSMITTANCE_CUT_DEFAULT,
    RenderOptions,
};
pub use scene::{Scene, nerf_scene_memory, nerf_scene_open};
#[cfg(feature = "std")]
pub use scene_file::{nerf_scene_close, nerf_scene_open_file};
pub use scene_info::{Kind, SceneInfo, TableStorage, Text, nerf_scene_describe};
pub use status::{Status, nerf_status_text};
pub use target::{Plane, Target};
pub use version::{NERF_ABI_VERSION, nerf_abi_version, nerf_version_text};
pub use worker::{Request, Worker, nerf_worker_open, nerf_worker_size};
