//! `guard4d disclose`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::error::EngineError;
use guard4d_engine::release::disclosure;

use crate::flags::common::Common;
use crate::flags::overwrite::Overwrite;
use crate::flags::passphrase::PassphraseArgs;
use crate::shared::device;
use crate::ui::outcome::Outcome;
use crate::ui::report::note;

/// What is disclosed, and where to.
#[derive(Args, Debug)]
pub(crate) struct DiscloseArgs {
    /// Owner key
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    #[command(flatten)]
    passphrase: PassphraseArgs,
    /// Receipt of the asset; its folder holds the extractor
    #[arg(long, value_name = "FILE")]
    receipt: PathBuf,
    /// Folder for what whoever verifies needs: the asset's key, the receipt and the extractor
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// CLIP checkpoint that the key was made with: `mini` or a folder
    #[arg(long, default_value = "mini")]
    clip: String,
    #[command(flatten)]
    overwrite: Overwrite,
}

pub(crate) fn run(args: &DiscloseArgs, common: &Common) -> Result<Outcome, EngineError> {
    let device = device::open(common)?;
    let clip = device::load_clip(&device, &args.clip, common)?;
    let owner = args.passphrase.key(&args.key, &clip, common)?;
    disclosure::write(&owner, &args.receipt, &args.out, args.overwrite.existing())?;
    let told = "whoever has it can read and remove the mark of this asset, and of no other";
    note(common, &format!("wrote {}; {told}", args.out.display()));
    Ok(Outcome::Done)
}
