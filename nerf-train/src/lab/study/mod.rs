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
//! *Exact* renders every sample inside the scene box, without transmittance or colour cut, with polynomial sines, in
//! f32 with the fastest instructions; with the occupancy grid only if the blob says that the grid is part of the model.
//! *Base* has a renderer's default settings. Knobs, settings that trade accuracy for time, are varied one at a time.

mod combine;
mod front;
mod knobs;
mod run;

pub use front::{Price, cheapest_within, pareto, thin};
pub use knobs::{KNOBS, Knob};
pub use run::{BLOB_LOSS_DB, Effort, Progressed, Study, TRAINED_STEP_LOSS_DB};
