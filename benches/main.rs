//! Benchmarks of the kernels and of the embedding step, in device time and CPU time.
//!
//! `./x bench` runs all quick rows and writes `benches/results/<date>-<device>/`; `./x bench --compare A B` sets two such
//! folders side by side.

#![allow(clippy::cast_possible_truncation, reason = "test data is made of small numbers")]

mod chart;
mod clip;
mod compare;
mod embed;
mod harness;
mod host;
mod image;
mod loss;
mod memory;
mod nn;
mod optim;
mod probe;
mod report;
mod scaling;
mod scan;
mod scene;
mod splat;
mod stats;
mod svg;
mod target;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use guard4d_engine::EngineError;
use guard4d_kernels::{Device, DeviceOptions, DeviceSelect, FamilySelect};

type Outcome = Result<(), EngineError>;

/// Measures kernels, CLIP's image tower and embedding steps. Paths are relative to the repository.
#[derive(Debug, Parser)]
#[command(name = "./x bench")]
struct Args {
    /// Only rows whose names contain one of these, and the probes that shares are taken of
    filters: Vec<String>,
    /// Also fit how the cost grows with views, frames and splats, and embed into large scenes within a memory budget
    #[arg(long)]
    full: bool,
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
    let mut bench = harness::Bench::new(device, args.filters.clone());
    bench.scenes.clone_from(&args.scenes);
    for family in [
        probe::measure,
        nn::measure,
        clip::measure,
        image::measure,
        loss::measure,
        optim::measure,
        scan::measure,
        splat::measure,
        embed::measure,
    ] {
        family(&mut bench)?;
    }
    if args.full {
        scaling::measure(&mut bench)?;
        memory::measure(&mut bench)?;
    }
    report::write(&bench, args)?;
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
