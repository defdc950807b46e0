//! What a capture's own reconstruction says of the scene before anything is fitted: where key points lie, which space
//! is free, and how bright each photograph is.

pub mod check;
pub mod exposure;
pub mod sights;

#[cfg(test)]
mod tests;
