//! The command line: typed options, one file per command.

mod audit;
mod check;
mod common;
mod completions;
mod config;
mod demo;
mod eval;
mod explain;
mod export;
mod fit;
mod image;
mod import;
mod inspect;
mod lines;
mod options;
mod places;
mod poses;
mod render;
mod show;
mod study;
mod sweep;

pub use config::commented;
pub use lines::lines;
pub use options::settings::{SetOption, read_config};

use crate::system::summary::to_json;
use clap::{ArgAction, CommandFactory, Parser, Subcommand};
use std::collections::BTreeMap;
use std::process::ExitCode;

/// Command line: a command with its own options, and the options that all commands share.
#[derive(Debug, Parser)]
#[command(
    name = "nerf-train",
    version,
    about,
    disable_help_flag = true,
    after_help = "Example, and the place to start: nerf-train demo\n\n\
        Ctrl-C, SIGTERM and SIGHUP end a command and leave no half-written file. Written before it ends: the checkpoint of \
        `fit`, the scene file of `image fit`, the report of a sweep's finished runs.\n\
        Exit status: 0 success, 1 error, 2 wrong usage, 128 + N when ended by signal N (130 after Ctrl-C)."
)]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    global: common::Global,
    /// Print help.
    // Short help for `-h` and `--help`: the long form puts every flag on lines of its own, five screens of them.
    #[arg(short, long, global = true, action = ArgAction::HelpShort, help_heading = "Options of every command")]
    help: Option<bool>,
}

// These variants have no doc comments: clap would show them in place of the commands' own, longer texts.
#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::Demo),
    Poses(poses::Poses),
    Check(check::Check),
    Show(show::Show),
    Fit(Box<fit::Fit>),
    Eval(eval::Eval),
    Study(Box<study::Study>),
    Audit(audit::Audit),
    Render(Box<render::Render>),
    #[command(subcommand)]
    Image(image::Image),
    #[command(subcommand)]
    Sweep(sweep::Sweep),
    Import(Box<import::Import>),
    Inspect(inspect::Inspect),
    Explain(explain::Explain),
    Export(export::Export),
    Config(config::PrintConfig),
    Completions(completions::Completions),
}

/// Returns one line with the error and its causes, except causes that the error's text already contains.
fn message(error: &anyhow::Error) -> String {
    let mut message = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !message.contains(&cause) {
            message = format!("{message}: {cause}");
        }
    }
    message
}

/// Prints the error as the only JSON object on stdout, for a calling program.
fn print_error(message: &str) {
    // An error here is ignored: the message is on stderr, too.
    let _ = to_json(&BTreeMap::from([("error", message)])).map(|json| common::print(json.trim_end()));
}

/// Reports on stderr that a signal ended the command; `message`: which results are kept.
pub(crate) fn interrupted(message: &str) {
    crate::system::progress::abandon();
    common::tell(message);
}

/// Calls [`interrupted`], then prints `message` as the field `error` of the only JSON object on stdout.
pub(crate) fn interrupted_json(message: &str) {
    interrupted(message);
    print_error(message);
}

/// Parses the arguments. Ends the process if the arguments are wrong or ask for help.
fn parse() -> Cli {
    Cli::try_parse().unwrap_or_else(|error| {
        // Parsing has failed, so `--json` is looked for in the raw arguments.
        if error.use_stderr() && std::env::args_os().any(|argument| argument == "--json") {
            let text = error.to_string();
            let first = text.split("\n\n").next().unwrap_or(&text);
            print_error(first.trim().trim_start_matches("error: "));
        }
        error.exit()
    })
}

/// Parses the arguments, runs the command, and turns an error into one message and a status.
///
/// Exit status: 0 success, 1 an error, 2 wrong usage, 128 + N when ended by signal N (130 after Ctrl-C).
pub fn main() -> ExitCode {
    common::survive_file_size_limits();
    let cli = parse();
    let say = if cli.global.json { interrupted_json } else { interrupted };
    if let Err(error) = crate::system::stop::watch(say) {
        common::tell(&format!("warning: signals end this command without saving: {error}"));
    }
    let result = cli.global.apply().and_then(|()| match cli.command {
        Command::Demo(demo) => demo.run(&cli.global),
        Command::Poses(poses) => poses.run(&cli.global),
        Command::Fit(fit) => fit.run(&cli.global),
        Command::Image(image) => image.run(&cli.global),
        Command::Sweep(sweep) => sweep.run(&cli.global),
        Command::Eval(eval) => eval.run(&cli.global),
        Command::Study(study) => study.run(&cli.global),
        Command::Audit(audit) => audit.run(&cli.global),
        Command::Render(render) => render.run(&cli.global),
        Command::Check(check) => check.run(&cli.global),
        Command::Show(show) => show.run(&cli.global),
        Command::Import(import) => import.run(&cli.global),
        Command::Inspect(inspect) => inspect.run(&cli.global),
        Command::Explain(explain) => explain.run(&cli.global),
        Command::Export(export) => export.run(&cli.global),
        Command::Config(config) => config.run(&cli.global),
        Command::Completions(completions) => completions.run(Cli::command(), &cli.global),
    });
    crate::system::stop::leave_to_signal();
    match result {
        Ok(status) => status,
        Err(error) => {
            let message = message(&error);
            common::tell(&format!("error: {message}"));
            if cli.global.json {
                print_error(&message);
            }
            ExitCode::FAILURE
        }
    }
}
