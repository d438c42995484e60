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

type Outcome = Result<(), guard4d_engine::EngineError>;

fn main() -> Outcome {
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
    report::write(&bench)
}
