//! `guard4d farm plan`

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use bytesize::ByteSize;
use clap::{Args, Command};
use guard4d_engine::error::EngineError;
use guard4d_engine::farm::forecast::{Forecast, bytes_of, left_of};
use guard4d_engine::farm::journal::Journal;
use guard4d_engine::farm::manifest::{Manifest, Row};
use guard4d_engine::farm::selection::{Selection, Share};
use serde::Serialize;

use super::job::{CommandLine, Dispatch};
use crate::flags::common::Common;
use crate::shared::session::Session;
use crate::ui::outcome::Outcome;
use crate::ui::report::{print, table};

/// What is planned.
#[derive(Args, Debug)]
pub(super) struct PlanArgs {
    /// Manifest: .csv or .jsonl
    manifest: PathBuf,
    /// Workers that the rows are dealt to
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    shards: u32,
    /// Try the largest asset of `embed` rows as `embed --dry-run` does, if none is done yet
    ///
    /// Takes a minute of the device. Without it, time, device memory and disk are told by the rows that are done.
    #[arg(long = "try")]
    tries: bool,
}

/// What would be done.
#[derive(Serialize)]
struct Plan {
    rows: usize,
    /// What is known of the rows of each job.
    jobs: BTreeMap<String, Forecast>,
    /// Columns that go into the records as they are.
    notes: Vec<String>,
    done: usize,
    shards: Vec<Share>,
}

pub(super) fn run(
    args: &PlanArgs,
    common: &Common,
    command: Command,
    dispatch: Dispatch<'_>,
) -> Result<Outcome, EngineError> {
    let io = |source| EngineError::Io { path: args.manifest.clone(), source };
    let path = if args.tries { std::path::absolute(&args.manifest).map_err(io)? } else { args.manifest.clone() };
    let manifest = Manifest::open(&path)?;
    let mut command = CommandLine::new(command);
    for row in manifest.rows() {
        command.check(manifest.path(), row)?;
    }
    let shards = Selection::default().shares(&manifest, args.shards as usize)?;
    let notes = command.unknown_columns(&manifest).into_iter().collect();
    let journal = Journal::open(&manifest.state(), "")?;
    let records = journal.of_rows(manifest.rows());
    let mut jobs = Forecast::of(&manifest, &records);
    if args.tries {
        // Paths of rows are relative to the manifest, whichever flag they stand behind.
        std::env::set_current_dir(manifest.folder()).map_err(io)?;
        for (job, forecast) in &mut jobs {
            if forecast.done == 0 && forecast.left > 0 && CommandLine::can_be_tried(job) {
                try_one(&manifest, &left_of(job, &manifest, &records), forecast, &mut command, common, dispatch)?;
            }
        }
    }
    let done = jobs.values().map(|forecast| forecast.done).sum();
    let plan = Plan { rows: manifest.rows().len(), jobs, notes, done, shards };
    print(common, &plan, human)?;
    Ok(Outcome::Done)
}

/// Tries the row with the largest input of those whose files are all there.
fn try_one(
    manifest: &Manifest,
    left: &[&Row],
    forecast: &mut Forecast,
    command: &mut CommandLine,
    common: &Common,
    dispatch: Dispatch<'_>,
) -> Result<(), EngineError> {
    let is_there = |need: &usize| manifest.folder().join(&manifest.rows()[*need].output).exists();
    let ready = left.iter().filter(|row| row.needs.iter().all(is_there));
    let sizes = ready.map(|row| (bytes_of(manifest, &row.input), *row));
    let Some((1.., row)) = sizes.max_by_key(|(bytes, _)| *bytes) else { return Ok(()) };
    let (job, matches) = command.parse_trial(manifest.path(), row)?;
    let session = Arc::<Session>::default();
    dispatch(&matches, Common { session: Some(Arc::clone(&session)), ..common.clone() })?;
    if let (Some(trial), Some(printed)) = (job.trial, session.take_result()) {
        forecast.take(manifest, row, trial(&printed), left);
    }
    Ok(())
}

fn human(plan: &Plan) -> String {
    let most = plan.shards.iter().map(|share| share.cost).fold(0.0, f64::max);
    let all: f64 = plan.shards.iter().map(|share| share.cost).sum();
    let share = most / all.max(f64::MIN_POSITIVE);
    let seconds: Option<f64> = plan.jobs.values().map(|forecast| forecast.seconds).sum();
    let time = seconds.map(|seconds| format!(", about {}", duration(seconds * share))).unwrap_or_default();
    let mut rows = vec![("rows", plan.rows.to_string()), ("done before", plan.done.to_string())];
    for (job, forecast) in &plan.jobs {
        rows.push(("job", format!("{job}: {}", told(forecast))));
    }
    rows.push(("shards", plan.shards.len().to_string()));
    rows.push(("the largest shard", format!("{:.1} % of all cost{time}", 100.0 * share)));
    if !plan.notes.is_empty() {
        rows.push(("columns that are no flags", plan.notes.join(", ")));
    }
    table(&rows)
}

/// What is known of a job's rows, in a line.
fn told(forecast: &Forecast) -> String {
    let Forecast { done, left, seconds, device_bytes, disk_bytes, tried } = forecast;
    if *left == 0 {
        return format!("{done} done, none left");
    }
    let size = |bytes: &u64| ByteSize(*bytes).to_string();
    let by = match tried {
        Some(id) => format!("as `{id}` would"),
        None if *done > 0 => format!("as the {done} that are done"),
        None => return format!("{left} left; time, device memory and disk are told once some are done"),
    };
    let time = seconds.map(duration).unwrap_or_default();
    let memory = device_bytes.as_ref().map(|bytes| format!(", {} of device memory", size(bytes))).unwrap_or_default();
    let disk = disk_bytes.as_ref().map(|bytes| format!(", {} of disk", size(bytes))).unwrap_or_default();
    format!("{left} left, about {time} one after the other{memory}{disk}; {by}")
}

fn duration(seconds: f64) -> String {
    match seconds {
        ..120.0 => format!("{seconds:.0} s"),
        120.0..7200.0 => format!("{:.0} min", seconds / 60.0),
        _ => format!("{:.1} h", seconds / 3600.0),
    }
}
