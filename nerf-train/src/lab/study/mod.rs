//! Study of render time against accuracy, from measurements.
//!
//! ```text
//! knobs ─► points ─► frames against truth and the exact rendering ─► one-knob rows
//!                         ▲                                               │ combine
//!                         └──────────── combinations worth trying ◄───────┘
//!                                              │
//!                                  Pareto front ─► report, blob
//! ```
//!
//! *Exact* renders every sample inside the scene box, in f32 with the fastest instructions, with polynomial sines. Rays
//! do not end early at low transmittance, and the colour of every sample is evaluated. The occupancy grid is used only
//! if the blob says that the grid is part of the model.
//!
//! *Base* has a renderer's default settings. Knobs, settings that trade accuracy for time, are varied one at a time.

mod combine;
mod front;
mod knobs;
mod run;

pub use front::{Price, cheapest_within, pareto, thin};
pub use knobs::{KNOBS, Knob};
pub use run::{BLOB_LOSS_DB, Effort, Progressed, Study, TRAINED_STEP_LOSS_DB};
