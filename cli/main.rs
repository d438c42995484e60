//! The `guard4d` command: parse, run, exit code; nothing else.

mod args;
mod attack;
mod convert;
mod demo;
mod devices;
mod dump;
mod embed;
mod film;
mod inspect;
mod keygen;
mod media;
mod model;
mod pretrain;
mod progress;
mod render;
mod report;
mod stop;
mod study;
mod verify;
mod views;

use std::io::IsTerminal as _;
use std::panic::{UnwindSafe, catch_unwind};
use std::process::ExitCode;

use clap::Parser;
use guard4d_engine::EngineError;
use guard4d_engine::error::INTERNAL_ERROR;
use tracing_subscriber::EnvFilter;

use args::{Cli, Command, Common};
use report::{Outcome, say};

fn main() -> ExitCode {
    ExitCode::from(guarded(|| {
        let cli = Cli::parse();
        start_log(&cli.common);
        match run(&cli) {
            Ok(outcome) => outcome.exit_code(),
            Err(error) => {
                let code = error.exit_code();
                say(&format!("{:?}", miette::Report::new(error)));
                code
            }
        }
    }))
}

/// Exit code of `work`, or of an internal error when it panics. The panic has been told where it happened; its unwinding
/// has removed partial outputs, which an end on the spot would leave.
fn guarded(work: impl FnOnce() -> u8 + UnwindSafe) -> u8 {
    catch_unwind(work).unwrap_or_else(|_| {
        say("guard4d: an error inside the program; please report it with the lines above");
        INTERNAL_ERROR
    })
}

fn run(cli: &Cli) -> Result<Outcome, EngineError> {
    match &cli.command {
        Command::Attack(args) => attack::run(args, &cli.common),
        Command::Convert(args) => convert::run(args, &cli.common),
        Command::Demo(args) => demo::run(args, &cli.common),
        Command::Devices => devices::run(&cli.common),
        Command::Dump(args) => dump::run(args, &cli.common),
        Command::Embed(args) => embed::run(args, &cli.common),
        Command::Inspect(args) => inspect::run(args, &cli.common),
        Command::Keygen(args) => keygen::run(args, &cli.common),
        Command::PretrainExtractor(args) => pretrain::run(args, &cli.common),
        Command::Render(args) => render::run(args, &cli.common),
        Command::Study(args) => study::run(args, &cli.common),
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

#[cfg(test)]
mod tests {
    use guard4d_engine::output::{AtomicDir, Existing};

    use super::{INTERNAL_ERROR, guarded};

    #[test]
    fn a_panic_is_an_internal_error_and_leaves_no_partial_output() {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let code = guarded(|| {
            let out = AtomicDir::create(&folder.path().join("out"), Existing::Refuse).expect("the folder is writable");
            std::fs::write(out.path().join("frame.png"), b"half").expect("the folder is writable");
            panic!("as a broken invariant would");
        });
        let left = std::fs::read_dir(folder.path()).expect("readable").count();
        assert_eq!((code, left), (INTERNAL_ERROR, 0), "exit code, and files left");
        assert_eq!(guarded(|| 4), 4, "other codes pass");
    }
}
