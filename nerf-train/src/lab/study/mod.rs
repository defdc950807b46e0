//! Time that accuracy costs, and value of each effect of a scene: measured, not guessed.
//!
//! ```text
//! knobs ─► points ─► frames against truth and the exact rendering ─► one-knob rows
//!                         ▲                                               │ combine
//!                         └──────────── combinations worth trying ◄───────┘
//!                                              │
//!                                  Pareto front ─► report, blob
//! ```
//!
//! *Exact* is every sample inside the scene box, no cuts, the exact encoding, f32 with the fastest instructions; with
//! the occupancy grid only if the blob says that it is part of the model. *Base* is the default of a renderer. Knobs
//! are varied one at a time from the base.

mod combine;
mod front;
mod knobs;
mod run;

pub use front::{Price, cheapest_within, pareto, thin};
pub use knobs::{KNOBS, Knob};
pub use run::{BLOB_LOSS_DB, Effort, Progressed, Study, TRAINED_STEP_LOSS_DB};
