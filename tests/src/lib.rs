//! What the tests that span the crates share: small scenes, C compilers, memory with canaries.
#![allow(unsafe_code, reason = "tests call the C interface")]

pub mod browser;
pub mod build;
pub mod call;
pub mod header;
pub mod memory;
pub mod paths;
pub mod scenes;
