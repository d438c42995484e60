//! The two files of a job for Thinkbox Deadline 10.
//!
//! They follow "Manual Job Submission" of its manual (10.0 and 10.1) and the plug-in `CommandLine` as it is published.
//! No tool has checked them: those of Deadline are in no package registry.

use std::path::Path;

use super::task::{Submission, printable, unnamed};
use crate::error::EngineError;

/// What the plug-in would take for an end of a path or for the beginning of a keyword. It makes curly quotes straight.
const TAKEN: [char; 4] = ['"', '<', '\u{201c}', '\u{201d}'];

/// What `deadlinecommand` is given.
#[derive(Clone, Debug)]
pub struct DeadlineFiles {
    /// Of the job: its name, and its frames.
    pub job: String,
    /// Of the plug-in: what to run.
    pub plugin: String,
}

impl Submission<'_> {
    /// Job info and plug-in info: a frame, and so a task, for each shard. Deadline tries a task again whatever its exit
    /// code was, until its own detection of failures says otherwise.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for paths that Deadline has no way to quote.
    pub fn deadline(&self) -> Result<DeadlineFiles, EngineError> {
        let (program, manifest, shards) = (plain(self.program)?, plain(self.manifest)?, self.shards);
        let job =
            format!("Plugin=CommandLine\nName=guard4d-farm\nComment={manifest}\nFrames=1-{shards}\nChunkSize=1\n");
        let arguments = format!("farm run <QUOTE>{manifest}<QUOTE> --shard <STARTFRAME>/{shards}");
        let plugin =
            format!("Executable={program}\nArguments={arguments}\nShellExecute=False\nSingleFramesOnly=True\n");
        Ok(DeadlineFiles { job, plugin })
    }
}

/// A path that means itself to the plug-in.
fn plain(path: &Path) -> Result<&str, EngineError> {
    let text = printable(path)?;
    if text.contains(TAKEN) {
        return Err(unnamed(path, "no quotes and no `<`, which Deadline reads otherwise"));
    }
    Ok(text)
}
