//! Benchmarks of the kernels and of the embedding step, in device time and CPU time.
//!
//! `./x bench` runs all quick rows and writes `benches/results/<date>-<device>/`; `./x bench --compare A B` sets two
//! such folders side by side; `./x bench --check` runs every row once and measures nothing.

#![allow(clippy::cast_possible_truncation, reason = "test data is made of small numbers")]

mod harness;
mod kernels;
mod pipeline;
mod report;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use guard4d_engine::error::EngineError;
use guard4d_kernels::{Device, DeviceOptions, DeviceSelect, FamilySelect};

use harness::{Bench, Effort};
use report::{Run, compare};

/// Measures kernels, CLIP's image tower and embedding steps. Paths are relative to the repository.
#[derive(Debug, Parser)]
#[command(name = "./x bench")]
struct Args {
    /// Only rows whose names contain one of these, and the probes that shares are taken of
    filters: Vec<String>,
    /// Also fit how the cost grows with views, frames and splats, and embed into large scenes within a memory budget
    #[arg(long)]
    full: bool,
    /// Measure nothing: run every row once, those of --full too, smaller where that saves much, and write no report.
    /// Fails when a row does, or when no row runs a kernel
    #[arg(long, conflicts_with_all = ["compare", "full", "out", "scenes"])]
    check: bool,
    /// Measure nothing: print ratios of two results folders, B to A, and flag what became slower
    #[arg(long, num_args = 2, value_names = ["A", "B"], conflicts_with_all = ["filters", "full", "out"])]
    compare: Vec<PathBuf>,
    /// Folder for table, summary and chart [default: benches/results/DATE-DEVICE, and none for a part of the rows]
    #[arg(long)]
    out: Option<PathBuf>,
    /// Also write the made scenes and guard4d's pictures of them into this folder, for `./x peers`
    #[arg(long, hide = true)]
    scenes: Option<PathBuf>,
    /// Vulkan device, as in `guard4d --help`
    #[arg(long, default_value = "auto", env = "GUARD4D_DEVICE")]
    device: DeviceSelect,
    /// Kernels to run on it: auto, lanes or tiles
    #[arg(long, default_value = "auto", env = "GUARD4D_KERNELS")]
    kernels: FamilySelect,
    /// Given by cargo
    #[arg(long, hide = true)]
    bench: bool,
}

impl Args {
    /// What makes the same rows again.
    fn command(&self) -> String {
        let full = if self.full { " --full" } else { "" };
        let filters: String = self.filters.iter().map(|part| format!(" '{part}'")).collect();
        let kernels = match self.kernels {
            FamilySelect::Auto => String::new(),
            only => format!(" --kernels {only}"),
        };
        format!("./x bench{full}{kernels}{filters}")
    }
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(missing) if missing.is_empty() => ExitCode::SUCCESS,
        Ok(missing) => {
            eprintln!("no row runs these kernels: {}", missing.join(", "));
            ExitCode::FAILURE
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

/// Measures, writes the report and returns the kernels that no row runs. How fast anything was makes no failure.
fn run(args: &Args) -> Result<Vec<&'static str>, EngineError> {
    if let [a, b] = args.compare.as_slice() {
        print!("{}", compare::table(&entries(a)?, &entries(b)?));
        return Ok(Vec::new());
    }
    let options = DeviceOptions { kernels: args.kernels, ..DeviceOptions::default() };
    let device = Device::open_with(&args.device, options)?;
    let effort = if args.check { Effort::Check } else { Effort::Measure };
    let (started, load) = (Instant::now(), report::host::load());
    let mut bench = Bench::new(device, args.filters.clone(), effort);
    bench.scenes.clone_from(&args.scenes);
    for family in [
        kernels::probe::measure,
        kernels::nn::measure,
        pipeline::clip::measure,
        kernels::image::measure,
        kernels::loss::measure,
        kernels::optim::measure,
        kernels::scan::measure,
        kernels::code::measure,
        kernels::splat::measure,
        pipeline::embed::measure,
    ] {
        family(&mut bench)?;
    }
    if args.full || args.check {
        pipeline::scaling::measure(&mut bench)?;
        pipeline::memory::measure(&mut bench)?;
    }
    if args.check {
        let rows = bench.rows.len() + bench.memory.len();
        println!(
            "{rows} rows ran once on {} kernels, in {:.0} s",
            bench.device.family(),
            started.elapsed().as_secs_f64()
        );
    } else {
        report::write(&bench, &Run { command: args.command(), load, out: args.out.clone() })?;
    }
    Ok(bench.unmeasured())
}

/// Rows of a results folder.
fn entries(folder: &Path) -> Result<Vec<compare::Entry>, EngineError> {
    let path = folder.join("results.csv");
    let text = std::fs::read_to_string(&path).map_err(|source| EngineError::Io { path: path.clone(), source })?;
    compare::parse(&text).map_err(|compare::Malformed { line, got, expected }| EngineError::BadData {
        path,
        field: format!("line {line}"),
        got,
        expected,
    })
}
