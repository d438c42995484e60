//! `guard4d commit`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::error::EngineError;
use guard4d_engine::release::dating::commit::commit;
use serde::Serialize;

use crate::flags::common::Common;
use crate::flags::overwrite::Overwrite;
use crate::ui::outcome::Outcome;
use crate::ui::report::{print, table};

/// What is put under one root.
#[derive(Args, Debug)]
pub(crate) struct CommitArgs {
    /// Receipts of embeddings
    #[arg(required = true, value_name = "RECEIPT")]
    receipts: Vec<PathBuf>,
    /// File for the root, with the commitments of all receipts
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// What was made.
#[derive(Serialize)]
struct Committed {
    root: String,
    receipts: u32,
}

pub(crate) fn run(args: &CommitArgs, common: &Common) -> Result<Outcome, EngineError> {
    let root = commit(&args.receipts, &args.out, args.overwrite.existing())?;
    let made = Committed { root: root.root().to_string(), receipts: root.receipts() };
    print(common, &made, |made| table(&[("root", made.root.clone()), ("receipts", made.receipts.to_string())]))?;
    Ok(Outcome::Done)
}
