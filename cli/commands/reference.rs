//! `guard4d reference`: pages of the reference, made of the definitions that parse the command line.

use clap::{Args, Command, ValueEnum};
use guard4d_engine::error::EngineError;

use crate::shared::visible::visible;
use crate::ui::config_markdown::config_markdown;
use crate::ui::markdown;
use crate::ui::outcome::Outcome;
use crate::ui::report::print_text;

/// Which page.
#[derive(Args, Debug)]
pub(crate) struct ReferenceArgs {
    /// Page to print
    #[arg(value_enum)]
    page: Page,
}

/// Pages of the reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Page {
    /// Commands and flags: docs/reference/cli.md
    Cli,
    /// Settings of `embed`: docs/reference/config.md
    Config,
}

pub(crate) fn run(args: &ReferenceArgs, command: &Command) -> Result<Outcome, EngineError> {
    match args.page {
        Page::Cli => print_text(&markdown::commands(visible(command)))?,
        Page::Config => print_text(&config_markdown())?,
    }
    Ok(Outcome::Done)
}
