#![no_std]
//! Radiance fields in fixed memory.
pub mod camera;
pub mod lens;
pub mod ray;
