//! The ffmpeg and ffprobe programs as child processes.

use std::ffi::OsString;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::thread::JoinHandle;

use crate::error::EngineError;

/// Most of a program's own words that are kept.
const MAX_MESSAGE_BYTES: usize = 2000;

/// Where the two programs are. ffmpeg 5.1 or newer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ffmpeg {
    /// Encoder and decoder.
    pub ffmpeg: PathBuf,
    /// Inspector.
    pub ffprobe: PathBuf,
}

impl Default for Ffmpeg {
    /// The programs of that name on the search path.
    fn default() -> Self {
        Self { ffmpeg: PathBuf::from("ffmpeg"), ffprobe: PathBuf::from("ffprobe") }
    }
}

/// A path as ffmpeg must see it: never an option, a URL or a pattern.
pub(super) fn file_argument(path: &Path) -> OsString {
    let mut argument = OsString::from("file:");
    argument.push(path);
    argument
}

/// Starts a program with piped streams.
pub(super) fn spawn(program: &Path, command: &mut Command) -> Result<Running, EngineError> {
    // A terminal sends Ctrl-C to a whole group. What to do about it is for the program above to say: were the child to
    // end first, an interruption would look like a failure of the child.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let mut child = child.map_err(|error| failed(program, &explain(&error)))?;
    let stderr = child.stderr.take().expect("stderr was piped above");
    Ok(Running { program: program.to_path_buf(), child, messages: Some(std::thread::spawn(move || tail(stderr))) })
}

fn explain(error: &std::io::Error) -> String {
    if error.kind() == std::io::ErrorKind::NotFound {
        return "not found; install ffmpeg, set GUARD4D_FFMPEG and GUARD4D_FFPROBE, or use a \
                folder of PNG frames"
            .to_owned();
    }
    error.to_string()
}

/// Error of a program.
pub(super) fn failed(program: &Path, reason: &str) -> EngineError {
    EngineError::Program { program: program.display().to_string(), reason: reason.to_owned() }
}

/// Reads everything, so that the child never blocks, and keeps the end.
fn tail(mut stderr: ChildStderr) -> String {
    let mut kept = Vec::new();
    let mut block = [0; 4096];
    while let Ok(count @ 1..) = stderr.read(&mut block) {
        kept.extend_from_slice(&block[..count]);
        let surplus = kept.len().saturating_sub(MAX_MESSAGE_BYTES);
        kept.drain(..surplus);
    }
    String::from_utf8_lossy(&kept).trim().to_owned()
}

/// A child process that does not outlive this value.
pub(super) struct Running {
    program: PathBuf,
    pub(super) child: Child,
    messages: Option<JoinHandle<String>>,
}

/// How a program ended.
pub(super) struct Ended {
    pub(super) success: bool,
    pub(super) messages: String,
}

impl Running {
    /// Waits for the end. Standard input must have been closed and standard output read.
    pub(super) fn wait(mut self) -> Result<Ended, EngineError> {
        let status = self.child.wait().map_err(|error| failed(&self.program, &error.to_string()))?;
        let messages = self.messages.take().map(JoinHandle::join);
        Ok(Ended { success: status.success(), messages: messages.and_then(Result::ok).unwrap_or_default() })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if self.messages.is_some() {
            // Both fail only if the child has ended already, which is what is wanted.
            let _already_ended = self.child.kill();
            let _already_reaped = self.child.wait();
        }
    }
}
