//! What accuracy costs in time, and what each effect of a scene is worth: measured, not guessed.
//!
//! ```text
//! knobs ─► points ─► frames against truth and the exact rendering ─► one-knob rows
//!                         ▲                                               │ combine
//!                         └──────────── combinations worth trying ◄───────┘
//!                                              │
//!                                  Pareto front ─► report, blob
//! ```
//!
//! *Exact* is every sample inside the scene box, no cuts, the exact encoding, f32 with the fastest instructions;
//! behind the occupancy grid only where the blob says that it is part of the model. *Base* is what a renderer
//! does when nobody asks for anything. Knobs are turned one at a time from the base.

mod audit;
mod combine;
mod error;
mod front;
mod knobs;
mod lab;
mod point;
mod report;
mod run;
mod settings;
pub mod training;

pub use audit::{
    Asked, Audit, AuditOptions, EFFECTS, Effect, THRESHOLD_DB, Verdict, Without, Worth, audit, flattened,
    mean_encoding, table as audit_table, without_direction,
};
pub use error::StudyError;
pub use front::{Price, cheapest_within, pareto, thin};
pub use knobs::{KNOBS, Knob};
pub use lab::source::unrounded;
pub use lab::{Bench, Clocked, Lab, Memory, Variant};
pub use point::{Clock, Origin, Point, Seconds, Totals, ViewErrors};
pub use report::{Findings, SPAN_LOSS_DB, Setting, front_of};
pub use run::{Effort, Progressed, Study};
pub use settings::{Precision, Settings};
