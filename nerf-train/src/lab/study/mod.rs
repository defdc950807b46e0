//! Study of render time against accuracy, from measurements.
//!
//! ```text
//! knobs ─► points ─► frames against truth and the exact rendering ─► one-knob rows
//!                         ▲                                               │ combine
//!                         └──────────── combinations worth trying ◄───────┘
//!                                              │
//!                                  Pareto front ─► report, file
//! ```
//!
//! A point is one choice of settings. A knob is a setting that trades accuracy for time. Knobs are varied one at a time
//! from the point *base*, a renderer's default settings. The point *exact* renders every sample inside the scene box,
//! in f32 with the fastest instructions and polynomial sines. No ray ends early at low transmittance, and every sample
//! gets a colour. The occupancy grid is used only if the scene file requires it.

mod combine;
mod front;
mod knobs;
mod run;

pub use front::{Price, cheapest_within, pareto, thin};
pub use knobs::{KNOBS, Knob};
pub use run::{BLOB_LOSS_DB, Effort, Progressed, Study, TRAINED_STEP_LOSS_DB};
