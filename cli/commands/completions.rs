//! `guard4d completions`

use clap::{Args, Command};
use clap_complete::{Shell, generate};
use guard4d_engine::error::EngineError;

use crate::shared::visible::visible;
use crate::ui::outcome::Outcome;
use crate::ui::report::print_text;

/// For which shell.
#[derive(Args, Debug)]
pub(crate) struct CompletionsArgs {
    /// Shell that is to read the script
    shell: Shell,
}

/// Prints the script for all of `command` that is not hidden.
pub(crate) fn run(args: &CompletionsArgs, command: &Command) -> Result<Outcome, EngineError> {
    let mut command = visible(command);
    let name = command.get_name().to_owned();
    let mut script = Vec::new();
    generate(args.shell, &mut command, name, &mut script);
    print_text(&String::from_utf8_lossy(&script))?;
    Ok(Outcome::Done)
}
