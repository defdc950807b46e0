//! Trains, evaluates and renders radiance fields on a CPU.
//!
//! The modules in the order in which data flows.

pub mod child;
pub mod cli;
pub mod config;
pub mod dataset;
pub mod decode;
pub mod demo_scene;
pub mod engine;
pub mod eval;
pub mod export;
pub mod field;
pub mod frame;
pub mod image_field;
pub mod import;
pub mod input;
pub mod memory;
pub mod occupancy;
pub mod orbit;
pub mod output;
pub mod poses;
pub mod printable;
pub mod quantise;
pub mod rays;
pub mod report;
pub mod show;
pub mod size;
pub mod stop;
pub mod study;
pub mod sweep;
pub mod train;
