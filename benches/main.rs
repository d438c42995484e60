//! Benchmarks of the kernels and of the embedding step, in device time.
//!
//! `./x bench` runs all and writes `benches/results/<date>-<device>/`; arguments choose rows by name and write nothing.

#![allow(clippy::cast_possible_truncation, reason = "test data is made of small numbers")]

mod clip;
mod embed;
mod harness;
mod host;
mod image;
mod loss;
mod nn;
mod optim;
mod probe;
mod report;
mod scan;
mod splat;

use std::process::ExitCode;

use guard4d_engine::EngineError;

type Outcome = Result<(), EngineError>;

fn main() -> ExitCode {
    match run() {
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

/// Measures, writes the report and returns the kernels that no row runs.
fn run() -> Result<Vec<&'static str>, EngineError> {
    let mut bench = harness::Bench::open()?;
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
    report::write(&bench)?;
    Ok(bench.unmeasured())
}
