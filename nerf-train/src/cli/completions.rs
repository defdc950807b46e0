use super::common::{Global, print};
use clap::{Args, Command};
use clap_complete::{Shell, generate};
use serde::Serialize;
use std::process::ExitCode;

/// Print a shell completion script.
#[derive(Debug, Args)]
#[command(after_help = "Examples (they take effect in a new shell):
  nerf-train completions bash > ~/.local/share/bash-completion/completions/nerf-train
  nerf-train completions zsh > ~/.zfunc/_nerf-train    # with fpath+=~/.zfunc before compinit in ~/.zshrc
  nerf-train completions fish > ~/.config/fish/completions/nerf-train.fish
  nerf-train completions powershell >> $PROFILE")]
pub struct Completions {
    /// Shell to complete for.
    #[arg(value_enum)]
    shell: Shell,
}

impl Completions {
    /// Runs the command; `cli`: definition of the whole command line.
    pub fn run(&self, mut cli: Command, global: &Global) -> anyhow::Result<ExitCode> {
        let mut script = Vec::new();
        generate(self.shell, &mut cli, "nerf-train", &mut script);
        let script = String::from_utf8(script)?;
        let made = Script { shell: self.shell.to_string(), script };
        global.finish_with(&made, || print(made.script.trim_end()))
    }
}

#[derive(Debug, Serialize)]
struct Script {
    shell: String,
    script: String,
}
