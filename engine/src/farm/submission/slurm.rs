//! A script for Slurm.

use super::task::{Submission, quoted};
use crate::error::EngineError;

/// Largest array that Slurm takes unless its administrator says otherwise (`MaxArraySize`, slurm.conf(5)).
const ARRAY: usize = 1000;
/// How long before the end of its time a task is told, seconds: an embedding then has time to write a checkpoint.
const NOTICE_S: u32 = 60;

impl Submission<'_> {
    /// A script for `sbatch`: an array with a task for each shard. A task that is preempted, or runs out of time, ends
    /// with exit code 75 and goes on when it is requeued (`RequeueExit=75`).
    ///
    /// # Errors
    /// [`EngineError::Usage`] for more tasks than Slurm takes; [`EngineError::Usage`] for paths that no shell can name.
    pub fn slurm(&self) -> Result<String, EngineError> {
        self.at_most(ARRAY, "the largest array of Slurm's defaults")?;
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
}
