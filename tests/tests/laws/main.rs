//! Laws that span the crates: what a picture depends on, what a blob must be, what the f64 oracle itself is checked by.

mod blob_damage;
mod effects_cost;
mod oracle;
mod parity;
