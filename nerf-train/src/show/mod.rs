//! Results for people and other programs: pictures, plots, videos, 3D pages, tables and exports.

pub mod animation;
pub mod axis;
pub mod cameras;
pub mod colour_map;
pub mod contact_sheet;
pub mod export;
pub mod keyframes;
pub mod orbit;
pub mod plot;
pub mod render;
pub mod reports;
pub mod table;
pub mod text;
pub mod video;
pub mod view;
pub mod writer;
