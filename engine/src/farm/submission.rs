//! What a scheduler is asked to run: files for Slurm and OpenJD.

use std::path::Path;

use serde_json::{Value, json};

use crate::error::EngineError;

/// Largest array that Slurm takes unless its administrator says otherwise (`MaxArraySize`, slurm.conf(5)).
const SLURM_ARRAY: usize = 1000;
/// How long before the end of its time a Slurm task is told, seconds: an embedding then has time to write a checkpoint.
const NOTICE_S: u32 = 60;
/// The same of an OpenJD task that is cancelled.
const OPENJD_NOTICE_S: u32 = 30;

/// A manifest, and how its rows are dealt.
#[derive(Clone, Copy, Debug)]
pub struct Submission<'a> {
    /// This program, as nodes find it.
    pub program: &'a Path,
    /// The manifest, as nodes find it.
    pub manifest: &'a Path,
    /// Where logs go, as nodes find it.
    pub logs: &'a Path,
    /// Rows of the manifest, at least one.
    pub rows: usize,
    /// Tasks, at least one.
    pub shards: usize,
}

impl Submission<'_> {
    /// A script for `sbatch`: an array with a task for each shard. A task that is preempted, or runs out of time, ends
    /// with exit code 75 and goes on when it is requeued (`RequeueExit=75`).
    ///
    /// # Errors
    /// [`EngineError::Usage`] for more tasks than Slurm takes; [`EngineError::Usage`] for paths that no shell can name.
    pub fn slurm(&self) -> Result<String, EngineError> {
        if self.shards > SLURM_ARRAY {
            return Err(EngineError::Usage {
                what: "--shards".to_owned(),
                got: self.shards.to_string(),
                expected: format!("at most {SLURM_ARRAY}, the largest array of Slurm's defaults"),
            });
        }
        let (shards, logs) = (self.shards, quoted(&self.logs.join("slurm-%A_%a.log"))?);
        let command = self.command("--shard auto")?;
        Ok(format!(
            "#!/bin/bash
#SBATCH --job-name=guard4d-farm
#SBATCH --array=1-{shards}
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=TERM@{NOTICE_S}
#SBATCH --output={logs}
# srun passes the signal on; the batch shell would not. Exit code 75 asks to be requeued: RequeueExit=75 in slurm.conf.
srun --kill-on-bad-exit=1 {command}
exit $?
"
        ))
    }

    /// A job template of OpenJD (2023-09, with chunks of tasks), as JSON: a task for each row, of which about as many
    /// chunks are made as there are shards.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for paths that no shell can name.
    pub fn openjd(&self) -> Result<Value, EngineError> {
        let run = format!("#!/bin/bash\nexec {}\n", self.command("--rows {{Task.Param.Row}}")?);
        let last = self.rows - 1;
        Ok(json!({
            "specificationVersion": "jobtemplate-2023-09",
            "extensions": ["TASK_CHUNKING"],
            "name": "guard4d-farm",
            "steps": [{
                "name": "Rows",
                "parameterSpace": { "taskParameterDefinitions": [{
                    "name": "Row",
                    "type": "CHUNK[INT]",
                    "range": format!("0-{last}"),
                    "chunks": {
                        "defaultTaskCount": self.rows.div_ceil(self.shards),
                        "rangeConstraint": "NONCONTIGUOUS",
                    },
                }] },
                "script": {
                    "embeddedFiles": [{ "name": "run", "type": "TEXT", "runnable": true, "data": run }],
                    "actions": { "onRun": {
                        "command": "{{Task.File.run}}",
                        "cancelation": {
                            "mode": "NOTIFY_THEN_TERMINATE",
                            "notifyPeriodInSeconds": OPENJD_NOTICE_S,
                        },
                    } },
                },
            }],
        }))
    }

    /// The command of a task; `rows` says which.
    fn command(&self, rows: &str) -> Result<String, EngineError> {
        Ok(format!("{} farm run {} {rows}", quoted(self.program)?, quoted(self.manifest)?))
    }
}

/// A path as a shell takes it.
fn quoted(path: &Path) -> Result<String, EngineError> {
    let wrong = || EngineError::Usage {
        what: "path".to_owned(),
        got: path.display().to_string(),
        expected: "UTF-8 without NUL".to_owned(),
    };
    let text = path.to_str().ok_or_else(wrong)?;
    Ok(shlex::try_quote(text).map_err(|_| wrong())?.into_owned())
}
