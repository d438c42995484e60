//! Rows as command lines: the columns of a manifest are the flags of its jobs.

use std::any::TypeId;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use clap::{ArgAction, ArgMatches, Command};
use guard4d_engine::base::files::bad_data;
use guard4d_engine::error::EngineError;
use guard4d_engine::farm::manifest::{Manifest, Row};
use guard4d_engine::farm::runner::Attempt;

use crate::commands::{attack, convert, embed, keygen, locate, render, stamp, trace, verify};
use crate::flags::common::Common;
use crate::shared::farm_job::FarmJob;
use crate::ui::outcome::Outcome;

/// Runs a command that was parsed; `Common` is what all rows have in common.
pub(crate) type Dispatch<'a> = &'a (dyn Fn(&ArgMatches, Common) -> Result<Outcome, EngineError> + Sync);

/// What rows can ask for.
const JOBS: [&FarmJob; 9] = [
    &keygen::FARM,
    &embed::run::FARM,
    &verify::FARM,
    &render::FARM,
    &attack::FARM,
    &convert::FARM,
    &locate::FARM,
    &stamp::FARM,
    &trace::FARM,
];

/// Largest input of a light row: eight are done at once, and models take a few times the size of their file.
const LIGHT_BYTES: u64 = 16 << 20;

/// Flags of every command that a row has no say in: the farm has one device, and keeps the results.
const OF_THE_FARM: [&str; 10] =
    ["device", "help", "json", "kernels", "log-format", "precision", "quiet", "verbose", "version", "vram-budget"];

/// The command line, and what is known of its flags.
pub(super) struct CommandLine {
    command: Command,
    flags: BTreeMap<&'static str, BTreeMap<String, Kind>>,
    /// Jobs with columns that were parsed without a mistake, and whether they had no input.
    good: BTreeSet<Flags>,
    last_good: Option<Flags>,
}

/// What says whether a row's flags are right.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Flags {
    job: String,
    has_no_input: bool,
    columns: BTreeMap<String, String>,
}

impl Flags {
    fn are_of(&self, row: &Row) -> bool {
        self.job == row.job && self.has_no_input == row.input.is_empty() && self.columns == row.columns
    }
}

/// What a flag takes.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Value,
    /// A value that names a file.
    Path,
    /// Nothing: a column of it says whether it is given.
    Switch,
}

impl CommandLine {
    pub(super) fn new(mut command: Command) -> Self {
        command.build();
        let flags_of = |job: &&'static FarmJob| {
            let own = command.find_subcommand(job.command).expect("jobs are commands");
            let known = own.get_arguments().filter_map(|arg| {
                let kind = match arg.get_action() {
                    ArgAction::SetTrue => Kind::Switch,
                    _ if arg.get_value_parser().type_id() == TypeId::of::<PathBuf>() => Kind::Path,
                    _ => Kind::Value,
                };
                Some((arg.get_long()?.to_owned(), kind))
            });
            (job.command, known.collect())
        };
        let flags = JOBS.iter().map(flags_of).collect();
        Self { command, flags, good: BTreeSet::new(), last_good: None }
    }

    /// Finds mistakes in a row. What was found good in one row is good in all: paths may be anything.
    pub(super) fn check(&mut self, manifest: &Path, row: &Row) -> Result<(), EngineError> {
        // Rows beside each other are alike more often than not.
        if self.last_good.as_ref().is_some_and(|last| last.are_of(row)) {
            return Ok(());
        }
        let seen = Flags { job: row.job.clone(), has_no_input: row.input.is_empty(), columns: row.columns.clone() };
        if !self.good.contains(&seen) {
            self.parse(manifest, row, Attempt { number: 1, replaces: false, goes_on: false })?;
            self.good.insert(seen.clone());
        }
        self.last_good = Some(seen);
        Ok(())
    }

    /// The arguments of a row, parsed by the rules of the command line.
    pub(super) fn parse(
        &mut self,
        manifest: &Path,
        row: &Row,
        attempt: Attempt,
    ) -> Result<(&'static FarmJob, ArgMatches), EngineError> {
        self.parse_with(manifest, row, attempt, None)
    }

    /// The arguments that try a row whose command can be tried.
    pub(super) fn parse_trial(
        &mut self,
        manifest: &Path,
        row: &Row,
    ) -> Result<(&'static FarmJob, ArgMatches), EngineError> {
        let attempt = Attempt { number: 1, replaces: true, goes_on: false };
        self.parse_with(manifest, row, attempt, Some("--dry-run"))
    }

    fn parse_with(
        &mut self,
        manifest: &Path,
        row: &Row,
        attempt: Attempt,
        switch: Option<&str>,
    ) -> Result<(&'static FarmJob, ArgMatches), EngineError> {
        let bad = |column: &str, got: &str, expected: &str| {
            bad_data(manifest, format!("line {}: {column}", row.line), got, expected)
        };
        let Some(job) = JOBS.into_iter().find(|job| job.command == row.job) else {
            let known = JOBS.map(|job| job.command).join(", ");
            return Err(bad("job", &format!("`{}`", row.job), &known));
        };
        if job.has_input == row.input.is_empty() {
            let got = if job.has_input { "nothing" } else { &row.input };
            return Err(bad("input", got, if job.has_input { "what the job reads" } else { "nothing" }));
        }
        let mut words = vec!["guard4d".to_owned(), job.command.to_owned()];
        for (column, value) in &row.columns {
            let Some(kind) = self.flags[job.command].get(column) else { continue };
            if job.reserved.contains(&column.as_str()) || OF_THE_FARM.contains(&column.as_str()) {
                return Err(bad(column, &format!("`{value}`"), "no such column: the farm sets this flag"));
            }
            match (kind, value.as_str()) {
                (Kind::Value, value) => words.push(format!("--{column}={value}")),
                (Kind::Path, value) => words.push(format!("--{column}={}", resolve(value))),
                (Kind::Switch, "true") => words.push(format!("--{column}")),
                (Kind::Switch, "false") => {}
                (Kind::Switch, value) => return Err(bad(column, &format!("`{value}`"), "true or false")),
            }
        }
        words.extend(switch.map(str::to_owned));
        words.extend((job.arguments)(row, attempt));
        let parsed = self.command.try_get_matches_from_mut(&words);
        parsed.map(|matches| (job, matches)).map_err(|error| {
            let said = error.to_string();
            let first = said.lines().next().unwrap_or_default().trim_start_matches("error: ");
            bad("columns", first, &format!("flags of `guard4d {}`", job.command))
        })
    }

    /// Whether rows of a job can be tried.
    pub(super) fn can_be_tried(job: &str) -> bool {
        JOBS.iter().any(|known| known.command == job && known.trial.is_some())
    }

    /// Whether a row needs neither a device nor much memory.
    pub(super) fn is_light(&self, manifest: &Path, row: &Row) -> bool {
        let is_small = || {
            let input = manifest.parent().unwrap_or(Path::new("")).join(&row.input);
            std::fs::metadata(input).is_ok_and(|data| data.is_file() && data.len() <= LIGHT_BYTES)
        };
        JOBS.iter().any(|job| job.command == row.job && !job.needs_device) && is_small()
    }

    /// Columns that the row's job has no flag for.
    pub(super) fn unknown(&self, row: &Row) -> BTreeMap<String, String> {
        let Some(known) = self.flags.get(row.job.as_str()) else { return BTreeMap::new() };
        let unknown = row.columns.iter().filter(|(name, _)| !known.contains_key(*name));
        unknown.map(|(name, value)| (name.clone(), value.clone())).collect()
    }

    /// Columns that some row has and no row's job knows: mistyped ones are among them.
    pub(super) fn unknown_columns(&self, manifest: &Manifest) -> BTreeSet<String> {
        manifest.rows().iter().flat_map(|row| self.unknown(row).into_keys()).collect()
    }
}

/// A file whose name stands elsewhere: `env:NAME` in a variable of the node, `fd:N` is an open file, and `file:PATH` a
/// file of that name whatever it begins with. So a manifest can say which key is meant without saying where it lies.
fn resolve(value: &str) -> String {
    if let Some(name) = value.strip_prefix("env:") {
        // A variable that is not there leaves a name that no file has, so that the error names it.
        return std::env::var(name).unwrap_or_else(|_| value.to_owned());
    }
    if let Some(number) = value.strip_prefix("fd:") {
        return format!("/dev/fd/{number}");
    }
    value.strip_prefix("file:").unwrap_or(value).to_owned()
}
