//! Shared parts of the tests that span the crates: small scenes, C compilers, memory with canaries, memory between
//! fences.
#![allow(unsafe_code, reason = "tests call the C interface")]

pub mod browser;
pub mod build;
pub mod call;
pub mod error;
pub mod fence;
pub mod memory;
pub mod noise;
pub mod oracle;
pub mod paths;
pub mod scenes;
pub mod symbols;
pub mod tools;
