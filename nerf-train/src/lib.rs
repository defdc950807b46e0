//! Trains, evaluates and renders radiance fields on a CPU.
//!
//! The modules, in the order in which data flows, are `system`, `data`, `capture`, `model`, `train`, `measure`, `fit`,
//! `lab`, `show` and `cli`. Each module uses only the modules before it.

#![allow(missing_docs, reason = "a field or variant whose name says it needs no comment")]
#![cfg_attr(test, allow(dead_code, unused_imports, reason = "unit tests are built without the command line"))]

pub mod capture;
// Would be a third of the code that unit tests compile; its tests are in tests/cli.
#[cfg(not(test))]
pub mod cli;
pub mod data;
pub mod fit;
pub mod lab;
pub mod measure;
pub mod model;
pub mod show;
pub mod system;
pub mod train;

#[cfg(test)]
#[allow(dead_code, reason = "shared with the tests that span the crates")]
#[path = "../../tests/src/tools.rs"]
mod tools;
