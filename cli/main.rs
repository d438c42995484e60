//! The `guard4d` command: parse, run, exit code; nothing else.

mod command_line;
mod commands;
mod flags;
mod shared;
mod ui;

use std::panic::{UnwindSafe, catch_unwind};
use std::process::ExitCode;

use clap::{CommandFactory as _, FromArgMatches as _, Parser as _};
use guard4d_engine::error::{EngineError, INTERNAL_ERROR};

use command_line::{Cli, Command};
use commands::{
    attack, commit, completions, convert, demo, devices, disclose, embed, farm, inspect, keygen, lab, ledger, locate,
    man, reference, render, stamp, timestamp, trace, undo, verify,
};
use ui::log;
use ui::outcome::Outcome;
use ui::report::say;

fn main() -> ExitCode {
    ExitCode::from(guarded(|| {
        let cli = Cli::parse();
        log::start(&cli.common);
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

/// Exit code of `work`, or of an internal error when it panics. The panic has been told where it happened; its
/// unwinding has removed partial outputs, which an end on the spot would leave.
fn guarded(work: impl FnOnce() -> u8 + UnwindSafe) -> u8 {
    catch_unwind(work).unwrap_or_else(|_| {
        say("guard4d: an error inside the program; please report it with the lines above");
        INTERNAL_ERROR
    })
}

fn run(cli: &Cli) -> Result<Outcome, EngineError> {
    let common = &cli.common;
    match &cli.command {
        Command::Attack(args) => attack::run(args, common),
        Command::Commit(args) => commit::run(args, common),
        Command::Completions(args) => completions::run(args, &Cli::command()),
        Command::Convert(args) => convert::run(args, common),
        Command::Demo(args) => demo::run(args, common),
        Command::Devices => devices::run(common),
        Command::Disclose(args) => disclose::run(args, common),
        Command::Embed(args) => embed::run::run(args, common),
        Command::Farm(args) => farm::actions::run(args, common, Cli::command(), &|matches, common| {
            let refuse = |error: clap::Error| EngineError::Usage {
                what: "row".to_owned(),
                got: error.to_string(),
                expected: "a command line".to_owned(),
            };
            run(&Cli { common, ..Cli::from_arg_matches(matches).map_err(refuse)? })
        }),
        Command::Inspect(args) => inspect::run(args, common),
        Command::Keygen(args) => keygen::run(args, common),
        Command::Lab(args) => lab::run(args, common),
        Command::Ledger(args) => ledger::run(args, common),
        Command::Locate(args) => locate::run(args, common),
        Command::Man(args) => man::run(args, &Cli::command()),
        Command::Reference(args) => reference::run(args, &Cli::command()),
        Command::Render(args) => render::run(args, common),
        Command::Stamp(args) => stamp::run(args, common),
        Command::Timestamp(args) => timestamp::run(args, common),
        Command::Trace(args) => trace::run(args, common),
        Command::Undo(args) => undo::run(args),
        Command::Verify(args) => verify::run(args, common),
    }
}

#[cfg(test)]
mod tests {
    use guard4d_engine::base::output::{AtomicDir, Existing};

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
