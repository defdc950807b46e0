//! The command line: typed options, one file per command.

#[macro_use]
mod common;
mod demo;
mod eval;
mod fit;
mod inspect;
mod outcome;
mod render;
mod show;

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Trains a radiance field on two CPU cores and keeps it as one small file that renders anywhere.
#[derive(Debug, Parser)]
#[command(name = "nerf-train", version, about, after_help = "Start with: nerf-train demo")]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    global: common::Global,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The main job on a built-in scene: photograph, train, export, render, measure.
    Demo(demo::Demo),
    /// Fit a radiance field to posed photographs.
    Fit(Box<fit::Fit>),
    /// Measure a blob on views of a data set.
    Eval(eval::Eval),
    /// Render views of a blob.
    Render(render::Render),
    /// Print everything a blob says of itself.
    Inspect(inspect::Inspect),
    /// Draw a data set's cameras, and the rays and samples of one training step, in 3D.
    Show(show::Show),
}

/// One line of an error and its causes, none said twice: many an error's text holds its cause's.
fn message(error: &anyhow::Error) -> String {
    let mut message = format!("error: {error}");
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !message.contains(&cause) {
            message = format!("{message}: {cause}");
        }
    }
    message
}

/// Parses the arguments, runs the command, and turns an error into one message and a status.
///
/// Status 0 is success, 1 an error, 2 wrong usage, 130 an interruption.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = cli.global.apply().and_then(|()| match cli.command {
        Command::Demo(demo) => demo.run(&cli.global),
        Command::Fit(fit) => fit.run(&cli.global),
        Command::Eval(eval) => eval.run(&cli.global),
        Command::Render(render) => render.run(&cli.global),
        Command::Inspect(inspect) => inspect.run(),
        Command::Show(show) => show.run(&cli.global),
    });
    match result {
        Ok(status) => status,
        Err(error) => {
            common::tell(&message(&error));
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    /// The arguments behind `program` in a line of shell, up to a comment.
    fn arguments<'l>(line: &'l str, program: &str) -> Option<Vec<&'l str>> {
        let (_, arguments) = line.split('#').next()?.split_once(program)?;
        Some(arguments.split_whitespace().collect())
    }

    fn assert_parses(arguments: &[&str]) {
        let parsed = Cli::try_parse_from(["nerf-train"].iter().chain(arguments));
        assert!(parsed.is_ok(), "{arguments:?}: {}", parsed.unwrap_err());
    }

    #[test]
    fn commands_of_the_readme_parse() {
        let readme = concat!(env!("CARGO_MANIFEST_DIR"), "/../README.md");
        let text = std::fs::read_to_string(readme).expect("README.md");
        let shell = text.split("```sh\n").skip(1).filter_map(|block| block.split("```").next());
        let commands: Vec<_> = shell
            .flat_map(str::lines)
            .filter_map(|line| {
                arguments(line, "cargo run --release -- ").or_else(|| arguments(line, "nerf-train "))
            })
            .collect();
        assert!(commands.len() >= 7, "{commands:?}");
        commands.iter().for_each(|command| assert_parses(command));
    }

    #[test]
    fn examples_of_the_help_parse() {
        Cli::command().debug_assert();
        for command in Cli::command().get_subcommands() {
            let help = command.get_after_help().expect("an example").to_string();
            let examples: Vec<_> = help.lines().filter_map(|line| arguments(line, "nerf-train ")).collect();
            assert!(!examples.is_empty(), "{}", command.get_name());
            examples.iter().for_each(|example| assert_parses(example));
        }
    }
}
