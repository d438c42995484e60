//! `guard4d farm run`

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{ArgMatches, Args, Command};
use guard4d_engine::device::{Device, MemoryUse};
use guard4d_engine::error::EngineError;
use guard4d_engine::farm::crowd::DeviceMemory;
use guard4d_engine::farm::manifest::{Manifest, Row};
use guard4d_engine::farm::runner::{Attempt, Ended, Event, Jobs, Policy, Summary, Worker};
use guard4d_engine::farm::selection::{RowNumbers, Selection, Shard};
use serde::Serialize;

use super::job::{CommandLine, Dispatch};
use super::tell::{Teller, Watcher};
use crate::flags::common::Common;
use crate::flags::overwrite::Overwrite;
use crate::shared::farm_job::FarmJob;
use crate::shared::session::Session;
use crate::ui::outcome::Outcome;
use crate::ui::report::{print, table};
use crate::ui::stop;

/// Which rows are done, and what happens when some fail.
#[derive(Args, Debug)]
pub(super) struct RunArgs {
    /// Manifest: .csv or .jsonl
    manifest: PathBuf,
    /// Share of the rows that this worker takes: I/N, or auto for a task of a Slurm or SGE array
    ///
    /// Which rows that are depends on the manifest alone. A row stays with the one that makes its input.
    #[arg(long, value_name = "I/N")]
    shard: Option<String>,
    /// Rows by number from 0, such as 0,3,5-9 or 0-99:4
    #[arg(long, value_name = "LIST")]
    rows: Option<RowNumbers>,
    /// Rows by id
    #[arg(long, value_name = "ID", value_delimiter = ',')]
    ids: Vec<String>,
    /// Try rows again that failed
    #[arg(long)]
    retry_failed: bool,
    /// Begin no other row once one has failed
    #[arg(long, conflicts_with = "max_failures")]
    fail_fast: bool,
    /// Begin no other row once as many have failed
    #[arg(long, value_name = "N")]
    max_failures: Option<usize>,
    /// Rows to do at once that need the device, each with memory of its own [default: as many as measures faster]
    ///
    /// Two share the device once one was done alone and the memory holds both, and go on if that was faster; then
    /// three, up to four. Small conversions are done eight at once whatever this says.
    #[arg(long, value_name = "N")]
    at_once: Option<NonZeroUsize>,
    /// Who is told how far it is
    #[arg(long, value_enum, value_name = "WATCHER", default_value = "auto")]
    progress: Watcher,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Printed {
    done: usize,
    already: usize,
    failed: BTreeMap<String, String>,
    elsewhere: usize,
    left: usize,
}

pub(super) fn run(
    args: &RunArgs,
    common: &Common,
    command: Command,
    dispatch: Dispatch<'_>,
) -> Result<Outcome, EngineError> {
    let io = |source| EngineError::Io { path: args.manifest.clone(), source };
    let mut command = CommandLine::new(command);
    let manifest = Manifest::open(&std::path::absolute(&args.manifest).map_err(io)?)?;
    for row in manifest.rows() {
        command.check(manifest.path(), row)?;
    }
    let shard = args.shard.as_deref().map(|text| match text {
        "auto" => Shard::of_array(|variable| std::env::var(variable).ok()),
        text => text.parse(),
    });
    let selection = Selection { numbers: args.rows.clone(), ids: args.ids.clone(), shard: shard.transpose()? };
    let places = selection.places(&manifest)?;
    stop::listen(common);
    // Paths of rows are relative to the manifest, whichever flag they stand behind.
    std::env::set_current_dir(manifest.folder()).map_err(io)?;
    let mut teller = Teller::new(args.progress, common, places.len());
    let shared = Common { quiet: common.verbose == 0, ..common.clone() };
    let mut jobs = Commands { manifest: manifest.path(), command, shared, sessions: Vec::new(), dispatch };
    let policy = Policy {
        retry_failed: args.retry_failed,
        replace: args.overwrite.is_asked(),
        max_failures: if args.fail_fast { Some(1) } else { args.max_failures },
        at_once: args.at_once,
    };
    let mut watch = |event: Event<'_>| teller.tell(event);
    let summary = Worker::new(&manifest, policy, &mut jobs, &mut watch)?.run(&places)?;
    drop(teller);
    let outcome = outcome(&summary);
    let Summary { done, already, failed, elsewhere, left, .. } = summary;
    let printed = Printed { done, already, failed: failed.into_iter().collect(), elsewhere, left };
    print(common, &printed, human)?;
    outcome
}

fn outcome(summary: &Summary) -> Result<Outcome, EngineError> {
    match summary {
        Summary { is_interrupted: true, .. } => Ok(Outcome::RowsLeft),
        Summary { failed, .. } if !failed.is_empty() => Ok(Outcome::RowsFailed),
        _ => Ok(Outcome::Done),
    }
}

fn human(printed: &Printed) -> String {
    let Printed { done, already, failed, elsewhere, left } = printed;
    table(&[
        ("done", done.to_string()),
        ("done before", already.to_string()),
        ("failed", failed.len().to_string()),
        ("done by other workers", elsewhere.to_string()),
        ("left", left.to_string()),
    ])
}

/// Does rows by the commands of this program, in this process.
struct Commands<'a> {
    manifest: &'a Path,
    command: CommandLine,
    /// What all rows have in common.
    shared: Common,
    /// One for each row that is done at once: its device, and what is on it.
    sessions: Vec<Arc<Session>>,
    dispatch: Dispatch<'a>,
}

/// A row's command, ready to be run.
struct Parsed {
    job: &'static FarmJob,
    matches: ArgMatches,
    id: String,
    output: PathBuf,
}

impl Commands<'_> {
    fn parse(&mut self, row: &Row, attempt: Attempt) -> Result<Parsed, EngineError> {
        let (job, matches) = self.command.parse(self.manifest, row, attempt)?;
        Ok(Parsed { job, matches, id: row.id.clone(), output: PathBuf::from(&row.output) })
    }

    /// Sessions for as many rows at once.
    fn sessions(&mut self, rows: usize) -> &[Arc<Session>] {
        let have = self.sessions.len();
        self.sessions.resize_with(have.max(rows), Arc::default);
        &self.sessions[..rows]
    }
}

impl Parsed {
    fn run(&self, shared: &Common, session: &Arc<Session>, dispatch: Dispatch<'_>) -> Result<Ended, EngineError> {
        let shared = Common { session: Some(Arc::clone(session)), ..shared.clone() };
        // What is logged meanwhile names the row, whatever the level.
        let _row = tracing::error_span!("row", id = self.id).entered();
        let outcome = dispatch(&self.matches, shared)?;
        let printed = session.take_result().unwrap_or_default();
        let result = (self.job.keep)(&self.output, printed)?;
        let shortfall = (outcome == Outcome::GateMissed).then(|| "the quality gate was missed".to_owned());
        Ok(Ended { exit_code: outcome.exit_code(), shortfall, result })
    }
}

impl Jobs for Commands<'_> {
    fn run(&mut self, row: &Row, attempt: Attempt) -> Result<Ended, EngineError> {
        let row = self.parse(row, attempt)?;
        let session = Arc::clone(&self.sessions(1)[0]);
        row.run(&self.shared, &session, self.dispatch)
    }

    fn is_light(&self, row: &Row) -> bool {
        self.command.is_light(self.manifest, row)
    }

    fn run_at_once(&mut self, rows: &[(&Row, Attempt)]) -> Vec<Result<Ended, EngineError>> {
        let parsed: Vec<_> = rows.iter().map(|(row, attempt)| self.parse(row, *attempt)).collect();
        let sessions = self.sessions(rows.len()).to_vec();
        let (shared, dispatch) = (&self.shared, self.dispatch);
        std::thread::scope(|scope| {
            let start = |(row, session): (Result<Parsed, EngineError>, Arc<Session>)| {
                scope.spawn(move || row.and_then(|row| row.run(shared, &session, dispatch)))
            };
            let running: Vec<_> = parsed.into_iter().zip(sessions).map(start).collect();
            running.into_iter().map(|row| row.join().unwrap_or_else(|cause| resume_unwind(cause))).collect()
        })
    }

    fn device_memory(&self) -> Option<DeviceMemory> {
        let devices: Vec<Device> = self.sessions.iter().filter_map(|session| session.open_device()).collect();
        let uses: Vec<MemoryUse> = devices.iter().map(Device::memory_use).collect();
        Some(DeviceMemory {
            free: devices.first()?.free_memory()?,
            held: uses.iter().map(|used| used.reserved_bytes).sum(),
            row_peak: uses.iter().map(|used| used.peak_reserved_bytes).max()?,
        })
    }

    fn notes(&self, row: &Row) -> BTreeMap<String, String> {
        self.command.unknown(row)
    }

    fn forget_device(&mut self) {
        self.sessions.iter().for_each(|session| session.forget_device());
    }

    fn is_stopped(&self) -> bool {
        stop::is_requested()
    }
}
