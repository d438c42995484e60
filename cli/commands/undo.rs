//! `guard4d undo`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::error::EngineError;
use guard4d_engine::release::undo;

use crate::flags::overwrite::Overwrite;
use crate::ui::outcome::Outcome;

/// What is restored, and where to.
#[derive(Args, Debug)]
pub(crate) struct UndoArgs {
    /// Marked model or stamped copy: a folder, or a file of splats
    marked: PathBuf,
    /// The private undo.safetensors that `embed` wrote with it, or the file of `stamp --undo`
    #[arg(long, value_name = "FILE")]
    undo: PathBuf,
    /// Folder for the original model
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

pub(crate) fn run(args: &UndoArgs) -> Result<Outcome, EngineError> {
    undo::restore(&args.marked, &args.undo, &args.out, args.overwrite.existing())?;
    Ok(Outcome::Done)
}
