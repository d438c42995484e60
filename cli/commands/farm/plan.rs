//! `guard4d farm plan`

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::{Args, Command};
use guard4d_engine::error::EngineError;
use guard4d_engine::farm::manifest::Manifest;
use guard4d_engine::farm::selection::{Selection, Share};
use guard4d_engine::farm::status::Status;
use serde::Serialize;

use super::job::CommandLine;
use crate::flags::common::Common;
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
}

/// What would be done.
#[derive(Serialize)]
struct Plan {
    rows: usize,
    jobs: BTreeMap<String, usize>,
    /// Columns that go into the records as they are.
    notes: Vec<String>,
    done: usize,
    shards: Vec<Share>,
}

pub(super) fn run(args: &PlanArgs, common: &Common, command: Command) -> Result<Outcome, EngineError> {
    let manifest = Manifest::open(&args.manifest)?;
    let mut command = CommandLine::new(command);
    let mut jobs: BTreeMap<String, usize> = BTreeMap::new();
    for row in manifest.rows() {
        command.check(manifest.path(), row)?;
        *jobs.entry(row.job.clone()).or_default() += 1;
    }
    let shards = Selection::default().shares(&manifest, args.shards as usize)?;
    let notes = command.unknown_columns(&manifest).into_iter().collect();
    let plan = Plan { rows: manifest.rows().len(), jobs, notes, done: Status::of(&manifest)?.done, shards };
    print(common, &plan, human)?;
    Ok(Outcome::Done)
}

fn human(plan: &Plan) -> String {
    let jobs: Vec<String> = plan.jobs.iter().map(|(job, rows)| format!("{rows} {job}")).collect();
    let most = plan.shards.iter().map(|share| share.cost).fold(0.0, f64::max);
    let all: f64 = plan.shards.iter().map(|share| share.cost).sum();
    let mut rows = vec![
        ("rows", plan.rows.to_string()),
        ("jobs", jobs.join(", ")),
        ("done before", plan.done.to_string()),
        ("shards", plan.shards.len().to_string()),
        ("the largest shard", format!("{:.1} % of all cost", 100.0 * most / all.max(f64::MIN_POSITIVE))),
    ];
    if !plan.notes.is_empty() {
        rows.push(("columns that are no flags", plan.notes.join(", ")));
    }
    table(&rows)
}
