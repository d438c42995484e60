//! `guard4d timestamp`

use std::path::PathBuf;

use clap::{Args, Subcommand};
use guard4d_engine::error::EngineError;
use guard4d_engine::release::dating::request::Request;
use guard4d_engine::release::dating::response::{Attached, attach};
use guard4d_engine::release::dating::standing::check;
use guard4d_engine::release::dating::subject::{Subject, imprint};
use guard4d_engine::release::dating::token::{Stamp, Trust};
use serde::Serialize;

use crate::flags::common::Common;
use crate::flags::overwrite::Overwrite;
use crate::flags::trust::TrustArgs;
use crate::ui::dates::{dated, marks, when};
use crate::ui::outcome::Outcome;
use crate::ui::report::{note, print, table};

/// What is done about a date.
#[derive(Args, Debug)]
pub(crate) struct TimestampArgs {
    #[command(subcommand)]
    step: Step,
}

/// In the order of their use.
#[derive(Debug, Subcommand)]
enum Step {
    /// Writes a request that a time-stamping authority takes
    Request(RequestArgs),
    /// Puts the token of an authority's response beside what it dates
    Attach(AttachArgs),
    /// Says what a token is worth: what it dates, when, and who says so
    ///
    /// Without --ca nobody is trusted, and the exit code is 4 even for a token that is whole.
    Check(CheckArgs),
}

/// What is to be dated.
#[derive(Args, Debug)]
struct RequestArgs {
    /// Receipt, or root or proof of `commit`
    file: PathBuf,
    /// File for the request, such as request.tsq
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// What was dated, and the answer.
#[derive(Args, Debug)]
struct AttachArgs {
    /// Receipt, or root or proof of `commit`; the token is written beside it, receipt.tst for receipt.json
    file: PathBuf,
    /// What the authority answered
    #[arg(long, value_name = "FILE")]
    response: PathBuf,
    /// The request, when you still have it: the response has to repeat its random number
    #[arg(long, value_name = "FILE")]
    request: Option<PathBuf>,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// What is looked at, and who is trusted.
#[derive(Args, Debug)]
struct CheckArgs {
    /// Receipt, or root or proof of `commit`
    file: PathBuf,
    /// Token [default: the .tst file beside it]
    #[arg(long, value_name = "FILE")]
    timestamp: Option<PathBuf>,
    #[command(flatten)]
    trust: TrustArgs,
}

/// What is asked for.
#[derive(Serialize)]
struct Asked {
    of: String,
    sha256: String,
}

pub(crate) fn run(args: &TimestampArgs, common: &Common) -> Result<Outcome, EngineError> {
    match &args.step {
        Step::Request(args) => request(args, common),
        Step::Attach(args) => attach_token(args, common),
        Step::Check(args) => check_token(args, common),
    }
}

fn request(args: &RequestArgs, common: &Common) -> Result<Outcome, EngineError> {
    let digest = Subject::read(&args.file)?.digest();
    Request::new(&digest)?.write(&args.out, args.overwrite.existing())?;
    let sha256 = imprint(&digest).iter().map(|byte| format!("{byte:02x}")).collect();
    let asked = Asked { of: digest.to_string(), sha256 };
    print(common, &asked, |asked| table(&[("of", asked.of.clone()), ("its SHA-256", asked.sha256.clone())]))?;
    Ok(Outcome::Done)
}

fn attach_token(args: &AttachArgs, common: &Common) -> Result<Outcome, EngineError> {
    let existing = args.overwrite.existing();
    let Attached { path, stamp } = attach(&args.file, &args.response, args.request.as_deref(), existing)?;
    print(common, &stamp, human)?;
    note(common, &format!("wrote {}; `guard4d timestamp check` with --ca says what it is worth", path.display()));
    Ok(Outcome::Done)
}

fn human(stamp: &Stamp) -> String {
    let mut rows = vec![("date claimed", when(stamp)), ("authority", stamp.authority.clone())];
    rows.extend(marks(stamp));
    table(&rows)
}

fn check_token(args: &CheckArgs, common: &Common) -> Result<Outcome, EngineError> {
    let found = check(&args.file, args.timestamp.as_deref(), &args.trust.ca)?;
    print(common, &found, dated)?;
    Ok(match found.stamp.trust {
        Trust::Checked => Outcome::Done,
        Trust::Claimed => Outcome::DateClaimed,
    })
}
