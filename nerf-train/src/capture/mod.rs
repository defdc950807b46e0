//! Captures before training: lines of sight to sparse points, exposure of each photograph, and faults.

pub mod check;
pub mod exposure;
pub mod sights;

#[cfg(test)]
mod tests;
