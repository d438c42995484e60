//! `guard4d farm submit`

use std::path::{Path, PathBuf};
use std::process::Command;

use clap::{Args, ValueEnum};
use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::error::EngineError;
use guard4d_engine::farm::manifest::Manifest;
use guard4d_engine::farm::submission::Submission;

use crate::flags::common::Common;
use crate::ui::outcome::Outcome;
use crate::ui::report::{note, print_text};

/// Which manifest goes where.
#[derive(Args, Debug)]
pub(super) struct SubmitArgs {
    /// Manifest: .csv or .jsonl, where all nodes see it
    manifest: PathBuf,
    /// Scheduler: Slurm, or one that takes OpenJD templates, such as AWS Deadline Cloud
    #[arg(long, value_enum)]
    engine: Engine,
    /// Tasks that the rows are dealt to
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    shards: u32,
    /// Print the file instead of writing and submitting it
    #[arg(long)]
    dry_run: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Engine {
    /// A script for an array job, which is submitted with `sbatch`
    Slurm,
    /// A job template, for `openjd run` or a farm's own way of submitting it
    Openjd,
}

pub(super) fn run(args: &SubmitArgs, common: &Common) -> Result<Outcome, EngineError> {
    let io = |source| EngineError::Io { path: args.manifest.clone(), source };
    let manifest = Manifest::open(&std::path::absolute(&args.manifest).map_err(io)?)?;
    let rows = manifest.rows().len();
    if rows == 0 {
        return Err(EngineError::Usage {
            what: args.manifest.display().to_string(),
            got: "no rows".to_owned(),
            expected: "something to do".to_owned(),
        });
    }
    let (program, logs) = (std::env::current_exe().map_err(io)?, manifest.state());
    let shards = rows.min(args.shards as usize);
    let submission = Submission { program: &program, manifest: manifest.path(), logs: &logs, rows, shards };
    let (name, text) = match args.engine {
        Engine::Slurm => ("slurm.sh", submission.slurm()?),
        Engine::Openjd => {
            let template = serde_json::to_string_pretty(&submission.openjd()?).expect("texts are JSON");
            ("openjd.template.json", format!("{template}\n"))
        }
    };
    if args.dry_run {
        print_text(&text)?;
        return Ok(Outcome::Done);
    }
    let path = logs.join(name);
    AtomicFile::write(&path, Existing::Replace, text.as_bytes())?;
    note(common, &format!("wrote {}", path.display()));
    match args.engine {
        Engine::Slurm => print_text(&format!("{}\n", submit(&path)?))?,
        Engine::Openjd => note(common, &format!("next: openjd run {}", path.display())),
    }
    Ok(Outcome::Done)
}

/// Hands a script to Slurm; the job's number.
fn submit(script: &Path) -> Result<String, EngineError> {
    let failed = |reason: String| EngineError::Program { program: "sbatch".to_owned(), reason };
    let ran = Command::new("sbatch").arg("--parsable").arg(script).output().map_err(|e| failed(e.to_string()))?;
    if !ran.status.success() {
        return Err(failed(String::from_utf8_lossy(&ran.stderr).trim().to_owned()));
    }
    Ok(String::from_utf8_lossy(&ran.stdout).trim().to_owned())
}
