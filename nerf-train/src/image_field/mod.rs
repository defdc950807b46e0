//! Fits a 2D neural field to a photograph: a radiance field without rays.
//!
//! photo → pixels drawn at random → engine → parameters → blob → picture of any size
//!
//! The network is the scenes' own with a 2-input encoding and only a colour head; engine, schedule,
//! export and renderer are those of the scenes too. What is here is what a picture has of its own:
//! reading it, drawing its pixels, and evaluating the whole of it now and then.

mod config;
mod photo;
mod run;

#[cfg(test)]
mod tests;

pub use config::{FieldConfig, FieldPreset};
pub use photo::{MAX_SIDE, Photo, PhotoError};
pub(crate) use run::MEASURED_ON;
pub use run::{Ended, Evaluation, FieldError, FieldTrainer, Outcome, RunOptions, kept, run};
