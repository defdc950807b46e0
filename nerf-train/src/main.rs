//! The `nerf-train` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    nerf_train::cli::main()
}
