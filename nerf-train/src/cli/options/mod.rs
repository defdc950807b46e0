//! Flags that several commands share.

pub mod axis;
pub mod data;
pub mod effects;
pub mod grid;
pub mod quality;
pub mod settings;
pub mod shard;
