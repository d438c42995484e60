//! `guard4d farm status`

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::error::EngineError;
use guard4d_engine::farm::manifest::Manifest;
use guard4d_engine::farm::status::Status;

use crate::flags::common::Common;
use crate::ui::outcome::Outcome;
use crate::ui::report::{print, table};
use crate::ui::stop;

/// Between two looks of `--watch`.
const LOOK_AGAIN: Duration = Duration::from_secs(2);
/// Most failures of one cause that are listed.
const LISTED: usize = 5;

/// Which manifest is looked at.
#[derive(Args, Debug)]
pub(super) struct StatusArgs {
    /// Manifest: .csv or .jsonl
    manifest: PathBuf,
    /// Look again every two seconds, until no row is left
    #[arg(long)]
    watch: bool,
    /// Also write the numbers for Prometheus, into the folder of node_exporter's textfile collector
    ///
    /// The file is replaced as a whole, with --watch at every look.
    #[arg(long, value_name = "FILE.prom")]
    metrics: Option<PathBuf>,
}

pub(super) fn run(args: &StatusArgs, common: &Common) -> Result<Outcome, EngineError> {
    let manifest = Manifest::open(&args.manifest)?;
    if args.watch {
        stop::listen(common);
    }
    loop {
        let status = Status::of(&manifest)?;
        if let Some(path) = &args.metrics {
            let name = manifest.path().file_name().unwrap_or_default().to_string_lossy();
            AtomicFile::write(path, Existing::Replace, status.prometheus(&name).as_bytes())?;
        }
        print(common, &status, human)?;
        let Status { rows, done, failed, .. } = status;
        if !args.watch || done + failed == rows {
            return Ok(if failed > 0 { Outcome::RowsFailed } else { Outcome::Done });
        }
        std::thread::sleep(LOOK_AGAIN);
        stop::check()?;
    }
}

fn human(status: &Status) -> String {
    let time = |seconds: f64| format!("{:.0} s", seconds);
    let mut rows = vec![
        ("rows", status.rows.to_string()),
        ("done", status.done.to_string()),
        ("running", status.running.to_string()),
        ("interrupted", status.interrupted.to_string()),
        ("failed", status.failed.to_string()),
        ("pending", status.pending.to_string()),
        ("work done", time(status.seconds)),
        ("work left, about", status.seconds_left.map_or("not known yet".to_owned(), time)),
    ];
    for slow in &status.slowest {
        rows.push(("slowest", format!("{} {:.1} s", slow.id, slow.seconds)));
    }
    for (code, failures) in &status.failures {
        rows.push(("failed with", format!("exit code {code}: {} rows", failures.len())));
        rows.extend(failures.iter().take(LISTED).map(|failure| ("", format!("{}: {}", failure.id, failure.error))));
    }
    table(&rows)
}
