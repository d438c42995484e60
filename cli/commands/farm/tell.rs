//! How far a run is, told as whoever watches it reads it.

use std::io::Write as _;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use guard4d_engine::farm::runner::Event;
use indicatif::ProgressBar;
use serde_json::json;

use crate::flags::common::Common;
use crate::ui::progress::bar;
use crate::ui::report::{print_text, say};

/// Set by OpenJD for whatever runs in a session.
const OPENJD_SESSION: &str = "OPENJD_SESSION_WORKING_DIR";
/// The number of the Slurm job that this process is part of.
const SLURM_JOB: &str = "SLURM_JOB_ID";
/// Between two comments on a Slurm job: its controller serves the whole cluster.
const COMMENT_EVERY: Duration = Duration::from_secs(30);

/// Who watches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Watcher {
    /// OpenJD or Slurm where it runs under one of them, else a bar
    Auto,
    /// A bar on a terminal
    Bar,
    /// A JSON object on stderr when a row begins, ends, or is passed over
    Json,
    /// OpenJD: lines on stdout
    Openjd,
    /// Slurm: the job's comment, at most every 30 seconds; `squeue -o %k` shows it
    Slurm,
}

/// Tells it.
pub(super) struct Teller {
    watcher: Watcher,
    bar: ProgressBar,
    commented: Option<Instant>,
    /// What OpenJD was told last: a hundred lines are enough.
    percent: Option<u64>,
}

impl Teller {
    pub(super) fn new(watcher: Watcher, common: &Common, rows: usize) -> Self {
        let is_set = |variable: &str| std::env::var_os(variable).is_some();
        let watcher = match watcher {
            Watcher::Auto if is_set(OPENJD_SESSION) => Watcher::Openjd,
            Watcher::Auto if is_set(SLURM_JOB) => Watcher::Slurm,
            Watcher::Auto => Watcher::Bar,
            asked => asked,
        };
        Self { watcher, bar: bar(common, rows as u64), commented: None, percent: None }
    }

    pub(super) fn tell(&mut self, event: Event<'_>) {
        match event {
            Event::Begins(row) => self.bar.set_message(row.id.clone()),
            Event::Passes(_) => self.bar.inc(1),
            Event::Ends(row, record) => {
                self.bar.inc(1);
                if let Some(error) = record.error.as_ref().filter(|_| self.watcher != Watcher::Json) {
                    self.bar.suspend(|| say(&format!("{}: {error}", row.id)));
                }
            }
        }
        let (done, of) = (self.bar.position(), self.bar.length().unwrap_or(1));
        match self.watcher {
            Watcher::Auto | Watcher::Bar => {}
            Watcher::Json => tell_json(event, done, of),
            Watcher::Openjd if matches!(event, Event::Begins(_)) => {}
            Watcher::Openjd => self.tell_openjd(done, of),
            Watcher::Slurm => self.tell_slurm(done, of),
        }
    }

    /// As its runners read it from stdout (How Jobs Are Run, 2023-09).
    fn tell_openjd(&mut self, done: u64, of: u64) {
        let percent = 100 * done / of.max(1);
        if self.percent.replace(percent) != Some(percent) {
            // That nobody listens costs no row.
            let _ = print_text(&format!("openjd_progress: {percent}\nopenjd_status: rows {done}/{of}\n"));
        }
    }

    fn tell_slurm(&mut self, done: u64, of: u64) {
        if self.commented.is_some_and(|last| last.elapsed() < COMMENT_EVERY && done < of) {
            return;
        }
        self.commented = Some(Instant::now());
        let Ok(job) = std::env::var(SLURM_JOB) else { return };
        let words = [format!("jobid={job}"), format!("comment=rows {done}/{of}")];
        let command =
            Command::new("scontrol").arg("update").args(words).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        // A comment that is not made costs no row, and a controller that is slow to answer no time.
        if let Ok(mut child) = command {
            std::thread::spawn(move || child.wait());
        }
    }
}

impl Drop for Teller {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

fn tell_json(event: Event<'_>, done: u64, of: u64) {
    let line = match event {
        Event::Begins(row) => json!({ "event": "begins", "row": row.id, "job": row.job, "done": done, "of": of }),
        Event::Passes(row) => json!({ "event": "passes", "row": row.id, "job": row.job, "done": done, "of": of }),
        Event::Ends(row, record) => json!({
            "event": "ends", "row": row.id, "job": row.job, "state": record.state, "seconds": record.seconds,
            "exit_code": record.exit_code, "error": record.error, "done": done, "of": of,
        }),
    };
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}
