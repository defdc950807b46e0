//! Information about a capture before training: lines of sight to sparse points, exposure of each photograph, and
//! faults of the capture.

pub mod check;
pub mod exposure;
pub mod sights;

#[cfg(test)]
mod tests;
