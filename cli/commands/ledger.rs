//! `guard4d ledger`

use std::path::PathBuf;

use clap::{Args, Subcommand};
use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::AtomicFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::release::issue_key;
use guard4d_engine::release::issue_root::root_of;
use guard4d_engine::release::ledger::{CopyRecord, Ledger, Terms};
use guard4d_engine::release::recipients::{Recipient, read};
use serde::Serialize;

use crate::flags::common::Common;
use crate::flags::overwrite::Overwrite;
use crate::ui::outcome::Outcome;
use crate::ui::report::{note, print, table};

/// What is asked of a ledger.
#[derive(Args, Debug)]
pub(crate) struct LedgerArgs {
    #[command(subcommand)]
    action: Action,
}

/// In the order of their use.
#[derive(Debug, Subcommand)]
enum Action {
    /// Takes numbers for recipients, whose copies `stamp` writes later
    Add(AddArgs),
    /// Lists all copies
    List(LedgerFile),
    /// Shows what the issue is, or the copy of a recipient, a number or a hash; no secret
    Show(ShowArgs),
    /// Writes all copies as a table
    Export(ExportArgs),
    /// Adds what other ledgers of the same issue know
    ///
    /// Two machines that stamp from copies of one ledger take the same numbers: have one of them do it, or `add` all
    /// recipients first.
    Merge(MergeArgs),
    /// Writes a root over the issue and its copies, which `timestamp` has dated before they are given away
    ///
    /// It says nothing to who lacks the ledger.
    Commit(WriteArgs),
    /// Writes the issue's key as a private file on its own: a backup that stays good while copies are added
    Key(WriteArgs),
    /// Makes a lost ledger again from its key
    ///
    /// Without a table of its copies it is empty: `add` the recipients in their old order, or `trace --copies`.
    Restore(RestoreArgs),
}

/// A ledger.
#[derive(Args, Debug)]
struct LedgerFile {
    /// The ledger, as `stamp` makes it
    ledger: PathBuf,
}

#[derive(Args, Debug)]
struct AddArgs {
    #[command(flatten)]
    file: LedgerFile,
    /// Recipients
    #[arg(value_name = "NAME", required_unless_present = "recipients")]
    names: Vec<String>,
    /// Table of recipients: CSV with a column `recipient`
    #[arg(long, value_name = "FILE", conflicts_with = "names")]
    recipients: Option<PathBuf>,
}

#[derive(Args, Debug)]
struct ShowArgs {
    #[command(flatten)]
    file: LedgerFile,
    /// Recipient, number or hash of a copy
    #[arg(value_name = "COPY")]
    copy: Option<String>,
}

#[derive(Args, Debug)]
struct ExportArgs {
    #[command(flatten)]
    file: LedgerFile,
    /// File to write: .csv or .json
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

#[derive(Args, Debug)]
struct MergeArgs {
    #[command(flatten)]
    file: LedgerFile,
    /// Other ledgers
    #[arg(required = true, value_name = "LEDGER")]
    others: Vec<PathBuf>,
}

#[derive(Args, Debug)]
struct WriteArgs {
    #[command(flatten)]
    file: LedgerFile,
    /// File to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

#[derive(Args, Debug)]
struct RestoreArgs {
    /// The issue's key, as `ledger key` writes it
    key: PathBuf,
    /// Ledger to make
    #[arg(long, value_name = "LEDGER")]
    out: PathBuf,
    /// Table of its copies, as `ledger export` writes it: .csv
    #[arg(long, value_name = "FILE")]
    copies: Option<PathBuf>,
}

/// What an issue is, without its secret.
#[derive(Serialize)]
struct About {
    original: String,
    splats: u64,
    strength: f64,
    psnr_db: f64,
    receipt: Option<String>,
    key_id: String,
    copies: usize,
    written: usize,
}

pub(crate) fn run(args: &LedgerArgs, common: &Common) -> Result<Outcome, EngineError> {
    match &args.action {
        Action::Add(args) => add(args, common)?,
        Action::List(file) => print(common, &Ledger::open(&file.ledger)?.copies()?, |copies| lines(copies))?,
        Action::Show(args) => show(args, common)?,
        Action::Export(args) => export(args)?,
        Action::Merge(args) => {
            let mut ledger = Ledger::open(&args.file.ledger)?;
            for other in &args.others {
                let added = ledger.merge(&Ledger::open(other)?)?;
                note(common, &format!("{}: {added} new", other.display()));
            }
        }
        Action::Commit(args) => {
            let root = root_of(&Ledger::open(&args.file.ledger)?)?;
            root.write(&args.out, args.overwrite.existing())?;
            let rows = [("root", root.root().to_string()), ("copies", (root.receipts() - 1).to_string())];
            print(common, &root, |_| table(&rows))?;
        }
        Action::Key(args) => {
            issue_key::write(&args.out, args.overwrite.existing(), Ledger::open(&args.file.ledger)?.terms())?;
        }
        Action::Restore(args) => restore(args)?,
    }
    Ok(Outcome::Done)
}

fn restore(args: &RestoreArgs) -> Result<(), EngineError> {
    let terms = issue_key::read(&args.key)?;
    // Read before the ledger is made, so that a bad table leaves none behind.
    let copies =
        args.copies.as_deref().map(|table| Ledger::read_csv(table).map(|copies| (table, copies))).transpose()?;
    let mut ledger = Ledger::create(&args.out, &terms)?;
    if let Some((table, copies)) = copies {
        ledger.add(&copies, table)?;
    }
    Ok(())
}

fn add(args: &AddArgs, common: &Common) -> Result<(), EngineError> {
    let recipients = read(args.recipients.as_deref(), &args.names)?;
    let records = Ledger::open(&args.file.ledger)?.reserve(&recipients)?;
    print(common, &records, |records| lines(records))
}

fn show(args: &ShowArgs, common: &Common) -> Result<(), EngineError> {
    let ledger = Ledger::open(&args.file.ledger)?;
    let Some(copy) = &args.copy else {
        let about = About::of(&ledger)?;
        return print(common, &about, About::human);
    };
    let of_recipient =
        Recipient::new(copy).ok().map(|recipient| ledger.of_recipient(&recipient)).transpose()?.flatten();
    let of_number = copy.parse().ok().map(|number| ledger.of_number(number)).transpose()?.flatten();
    let of_hash = Digest::from_hex(copy).map(|hash| ledger.of_hash(hash)).transpose()?.flatten();
    match of_recipient.or(of_number).or(of_hash) {
        Some(record) => print(common, &record, |record| lines(std::slice::from_ref(record))),
        None => Err(EngineError::Usage {
            what: "copy".to_owned(),
            got: copy.clone(),
            expected: format!("a recipient, number or hash that {} knows", args.file.ledger.display()),
        }),
    }
}

fn export(args: &ExportArgs) -> Result<(), EngineError> {
    let ledger = Ledger::open(&args.file.ledger)?;
    let bytes = match args.out.extension().and_then(|extension| extension.to_str()) {
        Some("csv") => ledger.csv()?,
        Some("json") => serde_json::to_vec_pretty(&ledger.copies()?).expect("records hold nothing that JSON cannot"),
        _ => {
            return Err(EngineError::Usage {
                what: "--out".to_owned(),
                got: args.out.display().to_string(),
                expected: "a name that ends in .csv or .json".to_owned(),
            });
        }
    };
    // Who got what is nobody else's business.
    AtomicFile::write_private(&args.out, args.overwrite.existing(), &bytes)
}

impl About {
    fn of(ledger: &Ledger) -> Result<Self, EngineError> {
        let Terms { original, splats, strength, psnr_db, receipt, .. } = ledger.terms();
        let copies = ledger.copies()?;
        Ok(Self {
            original: original.to_string(),
            splats: *splats,
            strength: *strength,
            psnr_db: *psnr_db,
            receipt: receipt.map(|receipt| receipt.to_string()),
            key_id: ledger.prf().key_id().to_string(),
            copies: copies.len(),
            written: copies.iter().filter(|copy| copy.hash.is_some()).count(),
        })
    }

    fn human(&self) -> String {
        let mut rows = vec![
            ("original", format!("{}, {} splats", self.original, self.splats)),
            ("PSNR of copies", format!("{:.1} dB, strength {:.3}", self.psnr_db, self.strength)),
            ("name of the key", self.key_id.clone()),
            ("copies", format!("{}, of which {} are written", self.copies, self.written)),
        ];
        rows.extend(self.receipt.clone().map(|receipt| ("receipt of the owner's mark", receipt)));
        table(&rows)
    }
}

/// A line for each copy.
fn lines(copies: &[CopyRecord]) -> String {
    let hash = |copy: &CopyRecord| copy.hash.map_or_else(|| "not written".to_owned(), |hash| hash.to_string());
    let line = |copy: &CopyRecord| format!("  copy {:5}  {}  {}", copy.copy, copy.recipient, hash(copy));
    copies.iter().map(line).collect::<Vec<_>>().join("\n")
}
