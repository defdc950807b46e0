//! The `nerf-train` command.
fn main() {}
