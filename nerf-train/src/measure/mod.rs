//! Measurements of a scene file: its contents, its error against photographs, and the time and work of rendering it.

pub mod audit;
pub mod bench;
pub mod eval;
pub mod frame;
pub mod import;
pub mod inspect;
pub mod metrics;
pub mod point;
pub mod surfaces;
