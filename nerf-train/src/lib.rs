//! Trains, evaluates and renders radiance fields on a CPU.
//!
//! The modules in the order in which data flows.

pub mod dataset;
pub mod engine;
