#![no_std]
//! Radiance fields in fixed memory.
pub mod blob;
pub mod camera;
pub mod encoding;
pub mod kernels;
pub mod lens;
pub mod math;
pub mod network;
pub mod plan;
pub mod ray;
pub mod render;
pub mod sampling;
pub mod volume;

#[cfg(test)]
mod testing;
