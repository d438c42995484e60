//! `guard4d farm submit`

use std::path::{Path, PathBuf};
use std::process::Command;

use clap::{Args, ValueEnum};
use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::error::EngineError;
use guard4d_engine::farm::manifest::Manifest;
use guard4d_engine::farm::submission::{CueNames, Submission};

use crate::flags::common::Common;
use crate::ui::outcome::Outcome;
use crate::ui::report::{note, print_text};

const SLURM: &str = "slurm.sh";
const OPENJD: &str = "openjd.template.json";
const OPENCUE: &str = "opencue.xml";
/// Flamenco makes the name of the job type of it.
const FLAMENCO: &str = "guard4d-farm.js";
/// Of the job, and of the plug-in.
const DEADLINE: [&str; 2] = ["deadline.job", "deadline.plugin"];

/// Which manifest goes where.
#[derive(Args, Debug)]
pub(super) struct SubmitArgs {
    /// Manifest: .csv or .jsonl, where all nodes see it
    manifest: PathBuf,
    /// Scheduler that files are written for; Slurm is handed its own at once
    #[arg(long, value_enum)]
    engine: Engine,
    /// Tasks that the rows are dealt to
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..))]
    shards: u32,
    /// Print what would be written instead of writing and submitting it
    #[arg(long)]
    dry_run: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Engine {
    /// A script for an array job, which is submitted with `sbatch`
    Slurm,
    /// A job template, for `openjd run` or a job bundle of AWS Deadline Cloud
    Openjd,
    /// A job specification for Cuebot, under the names in SHOW, SHOT and USER
    Opencue,
    /// A job type for Flamenco 3
    Flamenco,
    /// Job info and plug-in info for `deadlinecommand` of Thinkbox Deadline 10
    Deadline,
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
    let files = files(args.engine, &submission)?;
    if args.dry_run {
        let texts: Vec<_> = files.into_iter().map(|(_, text)| text).collect();
        print_text(&texts.join("\n"))?;
        return Ok(Outcome::Done);
    }
    for (name, text) in &files {
        let path = logs.join(name);
        AtomicFile::write(&path, Existing::Replace, text.as_bytes())?;
        note(common, &format!("wrote {}", path.display()));
    }
    match args.engine {
        Engine::Slurm => print_text(&format!("{}\n", submit(&logs.join(SLURM))?))?,
        engine => note(common, &format!("next: {}", next(engine, &logs))),
    }
    Ok(Outcome::Done)
}

/// What an engine takes: names of files, and texts.
fn files(engine: Engine, submission: &Submission<'_>) -> Result<Vec<(&'static str, String)>, EngineError> {
    Ok(match engine {
        Engine::Slurm => vec![(SLURM, submission.slurm()?)],
        Engine::Openjd => vec![(OPENJD, format!("{:#}\n", submission.openjd()?))],
        Engine::Opencue => vec![(OPENCUE, submission.opencue(&cue_names())?)],
        Engine::Flamenco => vec![(FLAMENCO, submission.flamenco()?)],
        Engine::Deadline => {
            let files = submission.deadline()?;
            vec![(DEADLINE[0], files.job), (DEADLINE[1], files.plugin)]
        }
    })
}

/// Names in OpenCue, from where pyoutline takes them and with its defaults. A job has no default user.
fn cue_names() -> CueNames {
    let [show, shot, user] = [("SHOW", "testing"), ("SHOT", "default"), ("USER", "")]
        .map(|(variable, default)| std::env::var(variable).unwrap_or_else(|_| default.to_owned()));
    CueNames { show, shot, user }
}

/// What is to be done with the files of an engine in `folder`.
fn next(engine: Engine, folder: &Path) -> String {
    let file = |name: &str| folder.join(name).display().to_string();
    match engine {
        Engine::Slurm => format!("sbatch {}", file(SLURM)),
        Engine::Openjd => format!("openjd run {}", file(OPENJD)),
        Engine::Opencue => format!(
            "python3 -c 'import opencue, sys; opencue.api.launchSpecAndWait(open(sys.argv[1]).read())' {}",
            file(OPENCUE)
        ),
        Engine::Flamenco => {
            format!("copy {} into scripts beside flamenco-manager; it says how jobs are submitted", file(FLAMENCO))
        }
        Engine::Deadline => format!("deadlinecommand {} {}", file(DEADLINE[0]), file(DEADLINE[1])),
    }
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
