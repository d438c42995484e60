//! Which of the checks run, with which program.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::figures::Figures;
use super::site::Ground;
use super::{chaos, openjd, scale, slurm};
use crate::error::{Naming, Result};
use crate::programs::guard4d;
use crate::workspace::{Workspace, say};

/// Run farms for real: on Slurm, in OpenJD's runner, with workers that are killed, and with many rows
#[derive(Args)]
pub(crate) struct FarmArgs {
    /// What is checked; all of it unless named
    #[arg(value_enum)]
    checks: Vec<Check>,
    /// A guard4d that is built already; unless given, this checkout's is built
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// Folder for the figures, one table for each check
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Rows that `scale` does; it plans ten times as many
    #[arg(long, value_name = "N", default_value_t = 100_000, value_parser = clap::value_parser!(u32).range(10..))]
    rows: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Check {
    /// An array of Slurm, interrupted, requeued and drained; needs root
    Slurm,
    /// A template in the runner of openjd-cli, which comes from PyPI
    Openjd,
    /// Workers that are killed, that fight, that have no room left and wrong clocks; needs root
    Chaos,
    /// How fast many rows are done, and in how much memory
    Scale,
}

/// All of them, in the order in which they run.
const ALL: [Check; 4] = [Check::Slurm, Check::Openjd, Check::Chaos, Check::Scale];

/// Runs the checks, and tells what they measured.
pub(crate) fn run(workspace: &Workspace, args: &FarmArgs) -> Result<()> {
    let program = match &args.program {
        Some(file) => file.canonicalize().of_file(file)?,
        None => guard4d(workspace)?,
    };
    let ground = Ground::new(program)?;
    for check in ALL.into_iter().filter(|check| args.checks.is_empty() || args.checks.contains(check)) {
        say(&format!("farm: {}", name(check)));
        let mut figures = Figures::default();
        let ended = match check {
            Check::Slurm => slurm::run(workspace, &ground, &mut figures),
            Check::Openjd => openjd::run(workspace, &ground, &mut figures),
            Check::Chaos => chaos::run(workspace, &ground, &mut figures),
            Check::Scale => scale::run(&ground, args.rows as usize, &mut figures),
        };
        // Also of one that failed: what was measured until then is true.
        print!("{}", figures.table());
        ended?;
        if let Some(folder) = &args.out {
            write(folder, check, &figures)?;
        }
    }
    Ok(())
}

fn name(check: Check) -> String {
    check.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

fn write(folder: &Path, check: Check, figures: &Figures) -> Result<()> {
    std::fs::create_dir_all(folder).of_file(folder)?;
    let path = folder.join(format!("{}.csv", name(check)));
    std::fs::write(&path, figures.csv()).of_file(&path)
}
