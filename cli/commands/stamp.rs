//! `guard4d stamp`

use std::path::{Path, PathBuf};

use clap::Args;
use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::fidelity::{DEFAULT_PSNR_DB, strength_for};
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::release::ledger::{CopyRecord, Ledger, Terms};
use guard4d_engine::release::recipients::{Recipient, read};
use guard4d_engine::release::stamping::{CopyFolder, Stamped, stamp_all};
use guard4d_engine::release::undo;
use guard4d_engine::scene::Model;
use serde::Serialize;

use crate::flags::common::Common;
use crate::flags::overwrite::Overwrite;
use crate::shared::farm_job::{FarmJob, keep_in_records, out_and_input};
use crate::shared::{device, model};
use crate::ui::outcome::Outcome;
use crate::ui::progress::bar;
use crate::ui::report::{note, print};
use crate::ui::stop;

/// What is stamped, and for whom.
#[derive(Args, Debug)]
pub(crate) struct StampArgs {
    /// Model, marked by `embed` or not: a folder, or a file of splats
    model: PathBuf,
    /// The issue's private ledger; it is made if it is missing
    #[arg(long, value_name = "FILE")]
    ledger: PathBuf,
    /// Recipients, a copy for each
    #[arg(long, value_name = "NAME,…", value_delimiter = ',', required_unless_present = "recipients")]
    to: Vec<String>,
    /// Table of recipients: CSV with a column `recipient`
    #[arg(long, value_name = "FILE", conflicts_with = "to")]
    recipients: Option<PathBuf>,
    /// Folder for the copies: a file or folder for each recipient, in the model's own format
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// PSNR of copies against the model, on views from all around; set once, when the ledger is made
    ///
    /// A louder stamp is found in worse films.
    #[arg(long, value_name = "DB", default_value_t = DEFAULT_PSNR_DB)]
    target_psnr: f64,
    /// Receipt of the owner's mark in the model, whose hash the ledger keeps
    #[arg(long, value_name = "FILE")]
    receipt: Option<PathBuf>,
    /// Also write what `undo` turns any copy back into the model with; keep it private
    #[arg(long, value_name = "FILE")]
    undo: Option<PathBuf>,
    /// Write the same copy again for recipients who have one
    #[arg(long)]
    again: bool,
    #[command(flatten)]
    overwrite: Overwrite,
}

pub(crate) const FARM: FarmJob = FarmJob {
    command: "stamp",
    has_input: true,
    needs_device: true,
    // A row that was cut short may have written down copies that its records do not know.
    arguments: |row, attempt| std::iter::once("--again".to_owned()).chain(out_and_input(row, attempt)).collect(),
    reserved: &["again", "out", "overwrite"],
    keep: keep_in_records,
    trial: None,
};

/// What was made.
#[derive(Serialize)]
struct Report {
    ledger: PathBuf,
    psnr_db: f64,
    strength: f64,
    copies: Vec<Copy>,
}

/// A copy that was written.
#[derive(Serialize)]
struct Copy {
    recipient: String,
    copy: u64,
    path: PathBuf,
    hash: Option<Digest>,
}

pub(crate) fn run(args: &StampArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    let recipients = read(args.recipients.as_deref(), &args.to)?;
    let model = model::open_in_kind(&args.model, common)?;
    model.check_writable()?;
    let mut ledger = match Ledger::open(&args.ledger) {
        Err(EngineError::MissingInput { .. }) => make_ledger(args, &model, common)?,
        opened => opened?,
    };
    ledger.check_original(model.digest(), model.gaussians.len())?;
    if let Some(path) = &args.undo {
        undo::write_for_copies(path, args.overwrite.existing(), &model)?;
    }
    let records = reserve(&mut ledger, &recipients, args.again)?;
    let terms = ledger.terms().clone();
    let issue = Issue::new(&model, ledger.prf(), terms.strength);
    let folder = CopyFolder { out: &args.out, model: &args.model, existing: args.overwrite.existing() };
    let progress = bar(common, records.len() as u64);
    let mut copies = Vec::new();
    stamp_all(&issue, &mut ledger, records, folder, &mut |group| {
        progress.inc(group.len() as u64);
        copies.extend(group.iter().map(Copy::of));
        stop::check()
    })?;
    progress.finish_and_clear();
    let Terms { psnr_db, strength, .. } = terms;
    let report = Report { ledger: args.ledger.clone(), psnr_db, strength, copies };
    print(common, &report, human)?;
    Ok(Outcome::Done)
}

impl Copy {
    fn of(stamped: &Stamped) -> Self {
        let CopyRecord { recipient, copy, hash, .. } = stamped.record.clone();
        Self { recipient, copy, path: stamped.path.clone(), hash }
    }
}

/// The ledger of a new issue, whose strength is measured here.
fn make_ledger(args: &StampArgs, model: &Model, common: &Common) -> Result<Ledger, EngineError> {
    let secret = MasterSecret::generate()?;
    let device = device::open(common)?;
    let strength = strength_for(&device, Issue::new(model, Prf::new(&secret), 1.0), args.target_psnr)?;
    let receipt = args.receipt.as_deref().map(Digest::of_file).transpose()?;
    let (original, splats) = (model.digest(), model.gaussians.len() as u64);
    let terms = Terms { secret, original, splats, strength, psnr_db: args.target_psnr, receipt };
    let ledger = match Ledger::create(&args.ledger, &terms) {
        // Somebody was faster, such as another row of a farm: theirs holds.
        Err(EngineError::CannotCreate { .. }) if args.ledger.is_file() => return Ledger::open(&args.ledger),
        made => made?,
    };
    note(common, &secrecy(&args.ledger));
    Ok(ledger)
}

fn secrecy(path: &Path) -> String {
    format!(
        "note: {} is a secret: who has it can stamp copies in anybody's name. Keep it, and a backup: without it no \
         copy has a name",
        path.display()
    )
}

fn reserve(ledger: &mut Ledger, recipients: &[Recipient], again: bool) -> Result<Vec<CopyRecord>, EngineError> {
    if !again {
        return ledger.reserve(recipients);
    }
    let known = recipients.iter().map(|recipient| ledger.of_recipient(recipient)).collect::<Result<Vec<_>, _>>()?;
    let missing = recipients.iter().zip(&known).filter(|(_, known)| known.is_none());
    let added = ledger.reserve(&missing.map(|(recipient, _)| recipient.clone()).collect::<Vec<_>>())?;
    Ok(known.into_iter().flatten().chain(added).collect())
}

fn human(report: &Report) -> String {
    let line = |copy: &Copy| format!("  copy {:5}  {}  {}", copy.copy, copy.recipient, copy.path.display());
    let lines: Vec<String> = report.copies.iter().map(line).collect();
    format!("{} copies, {:.1} dB each\n{}", lines.len(), report.psnr_db, lines.join("\n"))
}
