//! What a run leaves for people to read: pictures, plots, tables, summaries, progress.

pub mod animation;
pub mod axis;
pub mod colour_map;
pub mod contact_sheet;
pub mod error;
pub mod exr;
pub mod film;
pub mod metrics;
pub mod names;
pub mod picture;
pub mod plot;
pub mod progress;
pub mod summary;
pub mod table;
pub mod text;
pub mod video;
