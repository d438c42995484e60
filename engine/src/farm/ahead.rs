//! Reading what the next rows read while a row is done, so that it lies in memory when their turn comes.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use walkdir::WalkDir;

/// Inputs that may wait to be read.
const WAITING: usize = 16;
/// Most bytes of one input that are read ahead: larger ones would push each other out of memory.
const MAX_BYTES: u64 = 1 << 30;

/// A thread that reads files and keeps nothing of them.
#[derive(Debug)]
pub struct Ahead {
    asked: Option<SyncSender<PathBuf>>,
    thread: Option<JoinHandle<u64>>,
}

impl Default for Ahead {
    fn default() -> Self {
        let (asked, inputs) = sync_channel(WAITING);
        let thread = std::thread::Builder::new().name("farm-ahead".to_owned()).spawn(move || read_all(&inputs));
        // Without a thread rows read their inputs themselves, as they do anyway.
        Self { asked: Some(asked), thread: thread.ok() }
    }
}

impl Ahead {
    /// Asks for a file or a folder. What cannot be read is for the row to say; what comes while too many wait is left
    /// out.
    pub fn ask(&self, input: &Path) {
        if let Some(asked) = &self.asked {
            let _ = asked.try_send(input.to_path_buf());
        }
    }

    /// Waits until all that was asked for is read; how many bytes that were.
    #[must_use]
    pub fn finish(mut self) -> u64 {
        self.asked = None;
        self.thread.take().and_then(|thread| thread.join().ok()).unwrap_or(0)
    }
}

fn read_all(inputs: &Receiver<PathBuf>) -> u64 {
    inputs.iter().map(|input| read(&input)).sum()
}

/// Reads the regular files: others may wait for somebody to write.
fn read(input: &Path) -> u64 {
    let files = WalkDir::new(input).into_iter().filter_map(Result::ok).filter(|entry| entry.file_type().is_file());
    let mut left = MAX_BYTES;
    for file in files {
        let bytes = file.metadata().map_or(0, |data| data.len());
        if bytes <= left
            && let Ok(mut file) = File::open(file.path())
        {
            left -= io::copy(&mut file, &mut io::sink()).unwrap_or(0).min(left);
        }
    }
    MAX_BYTES - left
}
