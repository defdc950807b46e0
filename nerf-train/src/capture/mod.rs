//! Information that a capture's own reconstruction gives before a fit: positions of key points, free space, and the
//! brightness of each photograph.

pub mod check;
pub mod exposure;
pub mod sights;

#[cfg(test)]
mod tests;
