//! The C interface, called from Rust as a C host would: one file per part of the contract.
//!
//! All files are one test program, since linking a program takes CI seconds.
#![allow(unsafe_code, reason = "tests call the C interface")]

mod busy;
mod camera;
mod cases;
mod effects;
mod explain;
mod fences;
mod file;
mod hostile;
mod large;
mod overlaps;
mod picture;
mod planes;
mod proposal;
mod quality;
mod rays;
mod struct_size;
mod surface;
mod threads;
mod views;
mod workers;
