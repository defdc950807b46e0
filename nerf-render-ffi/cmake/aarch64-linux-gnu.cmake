# 64-bit ARM with Linux, from another machine: the compiler of Debian's gcc-aarch64-linux-gnu. Rust's standard library for
# it comes by `rustup target add aarch64-unknown-linux-gnu`, or of Debian's own compiler by libstd-rust-web-dev:arm64 and
# NERF_RENDER_CARGO=/usr/bin/cargo with RUSTC=/usr/bin/rustc in the environment.
set(CMAKE_SYSTEM_NAME Linux)
set(CMAKE_SYSTEM_PROCESSOR aarch64)
set(CMAKE_C_COMPILER aarch64-linux-gnu-gcc)
set(CMAKE_CXX_COMPILER aarch64-linux-gnu-g++)
