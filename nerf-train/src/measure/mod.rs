//! What a blob shows, how far that is from the pictures, and what it takes.

pub mod audit;
pub mod bench;
pub mod eval;
pub mod frame;
pub mod import;
pub mod inspect;
pub mod metrics;
pub mod point;
pub mod surfaces;
