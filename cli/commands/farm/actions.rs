//! What `guard4d farm` does.

use clap::{Args, Command, Subcommand};
use guard4d_engine::error::EngineError;

use super::job::Dispatch;
use super::{init, plan, report, run, status, submit};
use crate::flags::common::Common;
use crate::ui::outcome::Outcome;

/// What is done with a list of jobs.
#[derive(Args, Debug)]
pub(crate) struct FarmArgs {
    #[command(subcommand)]
    action: Action,
}

/// In the order of their use.
#[derive(Debug, Subcommand)]
enum Action {
    /// Writes a manifest of the models in a folder, to be edited
    Init(init::InitArgs),
    /// Says what would be done where, and finds mistakes in the manifest; writes nothing
    Plan(plan::PlanArgs),
    /// Does the rows that are not done yet
    ///
    /// Run it again to go on: what is done stays. Several may run at once, on one machine or on many.
    Run(run::RunArgs),
    /// Says how far a manifest is
    Status(status::StatusArgs),
    /// Tells what became of a manifest: a page, and all records in one database
    ///
    /// Records of all workers are merged into `ledger.sqlite` beside them.
    Report(report::ReportArgs),
    /// Hands a manifest to a scheduler: Slurm, OpenJD, OpenCue, Flamenco or Deadline
    Submit(submit::SubmitArgs),
}

pub(crate) fn run(
    args: &FarmArgs,
    common: &Common,
    command: Command,
    dispatch: Dispatch<'_>,
) -> Result<Outcome, EngineError> {
    match &args.action {
        Action::Init(args) => init::run(args, common),
        Action::Plan(args) => plan::run(args, common, command, dispatch),
        Action::Run(args) => run::run(args, common, command, dispatch),
        Action::Status(args) => status::run(args, common),
        Action::Report(args) => report::run(args, common),
        Action::Submit(args) => submit::run(args, common),
    }
}
