//! `guard4d keygen`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::base::output::AtomicFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::watermark::key::key_file::read_secret;
use guard4d_engine::watermark::key::owner_key::{Key, KeyReport};

use crate::flags::common::Common;
use crate::flags::overwrite::Overwrite;
use crate::flags::passphrase::PassphraseArgs;
use crate::shared::device;
use crate::shared::farm_job::{FarmJob, keep_in_records, out_and_input};
use crate::ui::outcome::Outcome;
use crate::ui::report::{note, print, table};

/// The key to make.
#[derive(Args, Debug)]
pub(crate) struct KeygenArgs {
    /// Key file to write; keep it private
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Message bits: a multiple of 8
    ///
    /// At most two less than the CLIP model has text positions (`mini`: 72).
    #[arg(long, default_value_t = 16)]
    bits: u32,
    /// CLIP checkpoint: `mini` (embedded) or a folder with config.json and model.safetensors
    #[arg(long, default_value = "mini")]
    clip: String,
    /// File with a 64-digit hex master secret, instead of a fresh random one
    #[arg(long, value_name = "FILE")]
    secret: Option<PathBuf>,
    #[command(flatten)]
    passphrase: PassphraseArgs,
    #[command(flatten)]
    overwrite: Overwrite,
}

pub(crate) const FARM: FarmJob = FarmJob {
    command: "keygen",
    has_input: false,
    needs_device: true,
    arguments: out_and_input,
    reserved: &["out", "overwrite"],
    keep: keep_in_records,
    trial: None,
};

pub(crate) fn run(args: &KeygenArgs, common: &Common) -> Result<Outcome, EngineError> {
    let existing = args.overwrite.existing();
    // Half a minute of training must not end at a place that cannot be written.
    drop(AtomicFile::create(&args.out, existing)?);
    let passphrase = args.passphrase.read()?;
    let device = device::open(common)?;
    let clip = device::load_clip(&device, &args.clip, common)?;
    let secret = read_secret(args.secret.as_ref())?;
    let (key, report) = Key::generate(&device, &clip, secret, args.bits)?;
    match passphrase {
        Some(passphrase) => key.write_sealed(&args.out, existing, &passphrase)?,
        None => key.write(&args.out, existing)?,
    }
    print(common, &report, human)?;
    let kept = format!("wrote {}; keep it private: whoever has it can write and read your marks", args.out.display());
    note(common, &kept);
    Ok(Outcome::Done)
}

fn human(report: &KeyReport) -> String {
    let at = |i: usize| report.spectrum.0.get(i - 1).copied().unwrap_or(0.0);
    table(&[
        ("key id", report.key_id.clone()),
        ("bits", report.bits.to_string()),
        (
            "spectrum",
            format!(
                "{:.4} (1st)  {:.4} (8th)  {:.4} ({}th, the weakest needed)",
                at(1),
                at(8),
                at(report.bits),
                report.bits
            ),
        ),
        (
            "held-out messages",
            format!(
                "{:.3} % of bits, {:.2} % of messages",
                100.0 * report.held_out_accuracy,
                100.0 * report.held_out_exact
            ),
        ),
        ("seconds", format!("{:.1}", report.seconds)),
    ])
}
