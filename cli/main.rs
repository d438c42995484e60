//! The `guard4d` command: parse, run, exit code; nothing else.

mod args;
mod demo;
mod devices;
mod dump;
mod embed;
mod inspect;
mod keygen;
mod media;
mod progress;
mod render;
mod report;
mod stop;
mod verify;
mod views;

use std::io::IsTerminal as _;
use std::process::ExitCode;

use clap::Parser;
use guard4d_engine::EngineError;
use tracing_subscriber::EnvFilter;

use args::{Cli, Command, Common};
use report::{Outcome, say};

fn main() -> ExitCode {
    let cli = Cli::parse();
    start_log(&cli.common);
    match run(&cli) {
        Ok(outcome) => ExitCode::from(outcome.exit_code()),
        Err(error) => {
            let code = error.exit_code();
            say(&format!("{:?}", miette::Report::new(error)));
            ExitCode::from(code)
        }
    }
}

fn run(cli: &Cli) -> Result<Outcome, EngineError> {
    match &cli.command {
        Command::Demo(args) => demo::run(args, &cli.common),
        Command::Devices => devices::run(&cli.common),
        Command::Dump(args) => dump::run(args, &cli.common),
        Command::Embed(args) => embed::run(args, &cli.common),
        Command::Inspect(args) => inspect::run(args, &cli.common),
        Command::Keygen(args) => keygen::run(args, &cli.common),
        Command::Render(args) => render::run(args, &cli.common),
        Command::Verify(args) => verify::run(args, &cli.common),
    }
}

/// Talk goes to stderr; stdout carries data only.
fn start_log(common: &Common) {
    let level = match (common.quiet, common.verbose) {
        (true, _) => "error",
        (false, 0) => "warn",
        (false, 1) => "debug",
        (false, _) => "trace",
    };
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    let colours = std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none();
    let log = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    log.with_target(false).with_ansi(colours).init();
}
