//! `guard4d man`

use std::path::PathBuf;

use clap::{Args, Command};
use clap_mangen::generate_to;
use guard4d_engine::base::output::AtomicDir;
use guard4d_engine::error::EngineError;

use crate::flags::overwrite::Overwrite;
use crate::shared::visible::visible;
use crate::ui::outcome::Outcome;

/// Where the pages go.
#[derive(Args, Debug)]
pub(crate) struct ManArgs {
    /// Folder for the pages: guard4d.1, guard4d-embed.1, …
    dir: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// Writes the pages of all of `command` that is not hidden.
pub(crate) fn run(args: &ManArgs, command: &Command) -> Result<Outcome, EngineError> {
    let folder = AtomicDir::create(&args.dir, args.overwrite.existing())?;
    let written = generate_to(visible(command), folder.path());
    written.map_err(|source| EngineError::Io { path: args.dir.clone(), source })?;
    folder.commit()?;
    Ok(Outcome::Done)
}
