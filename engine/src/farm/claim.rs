//! Who works on a row, so that two workers do not do it twice.
//!
//! A claim saves work; nothing depends on it, because outputs and records appear whole, and two workers on one row make
//! the same bytes. It is a hard link of the worker's own file: making a link is atomic on every file system, creating a
//! file that must not be there is not on old network file systems (open(2), under `O_EXCL`). The worker writes its file
//! again and again, and the file server's clock says when that was last: clocks of two machines need not agree.

use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

use crate::error::EngineError;

/// How often a worker says that it is there.
pub const BEAT: Duration = Duration::from_secs(20);
/// A claim whose worker was silent for as many beats is nobody's.
const MISSED_BEATS: u32 = 3;

/// The claims of one worker.
#[derive(Debug)]
pub struct Claims {
    folder: PathBuf,
    worker: String,
    /// The worker's own file.
    own: PathBuf,
    beat: Duration,
    heart: Option<(Sender<()>, JoinHandle<()>)>,
}

/// A row that this worker has to itself until this is dropped.
#[derive(Debug)]
pub struct Claim {
    claims: Arc<Claims>,
    path: PathBuf,
}

impl Claims {
    /// Makes the worker's file, and says from now on every `beat` that it is there.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] where the folder cannot be written.
    pub fn open(folder: &Path, worker: &str, beat: Duration) -> Result<Arc<Self>, EngineError> {
        let own = folder.join(format!(".{worker}"));
        let made = fs::create_dir_all(folder)
            .and_then(|()| OpenOptions::new().write(true).create_new(true).open(&own))
            .and_then(|mut file| write_name(&mut file, worker).map(|()| file));
        let refuse = |e: std::io::Error| EngineError::CannotCreate { path: own.clone(), reason: e.to_string() };
        let mut file = made.map_err(refuse)?;
        let (end, ended) = channel();
        let name = worker.to_owned();
        let heart = std::thread::spawn(move || {
            while ended.recv_timeout(beat) == Err(RecvTimeoutError::Timeout) {
                // A beat that cannot be written is one that others miss.
                if let Err(error) = write_name(&mut file, &name) {
                    tracing::warn!("claims: {error}");
                }
            }
        });
        let (folder, worker) = (folder.to_path_buf(), worker.to_owned());
        Ok(Arc::new(Self { folder, worker, own, beat, heart: Some((end, heart)) }))
    }

    /// Takes a row, unless another worker has it.
    ///
    /// # Errors
    /// [`EngineError::Io`]
    pub fn take(self: &Arc<Self>, id: &str) -> Result<Option<Claim>, EngineError> {
        let path = self.folder.join(id);
        let claim = || Some(Claim { claims: Arc::clone(self), path: path.clone() });
        let io = |source| EngineError::Io { path: path.clone(), source };
        match fs::hard_link(&self.own, &path) {
            Ok(()) => return Ok(claim()),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(source) => return Err(io(source)),
        }
        // A server may have made the link and lost its answer.
        if self.is_mine(&path) {
            return Ok(claim());
        }
        if !self.remove_if_stale(&path)? {
            return Ok(None);
        }
        match fs::hard_link(&self.own, &path) {
            Ok(()) => Ok(claim()),
            // Another was faster.
            Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(None),
            Err(source) => Err(io(source)),
        }
    }

    fn is_mine(&self, path: &Path) -> bool {
        fs::read_to_string(path).is_ok_and(|name| name == self.worker)
    }

    /// Takes away a claim whose worker is silent; whether it is gone.
    fn remove_if_stale(&self, path: &Path) -> Result<bool, EngineError> {
        let Some(beaten) = modified(path)? else { return Ok(true) };
        let now = self.server_time()?;
        if now.duration_since(beaten).unwrap_or_default() <= self.beat * MISSED_BEATS {
            return Ok(false);
        }
        // Renaming gives it to one of all who saw it. That one may have come late, and hold a new claim: it goes back.
        let aside = self.own.with_extension("stale");
        match fs::rename(path, &aside) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(true),
            Err(source) => return Err(EngineError::Io { path: path.to_path_buf(), source }),
        }
        let is_the_same = modified(&aside)? == Some(beaten);
        let put_back = if is_the_same { Ok(()) } else { fs::hard_link(&aside, path) };
        let io = |source| EngineError::Io { path: aside.clone(), source };
        fs::remove_file(&aside).map_err(io)?;
        match put_back {
            Err(error) if error.kind() != ErrorKind::AlreadyExists => Err(io(error)),
            _ => Ok(is_the_same),
        }
    }

    /// What the clock says that stamps the files.
    fn server_time(&self) -> Result<SystemTime, EngineError> {
        let probe = self.own.with_extension("clock");
        let io = |source| EngineError::Io { path: probe.clone(), source };
        let written = File::create(&probe).and_then(|mut file| {
            file.write_all(b"?")?;
            file.sync_all()
        });
        written.map_err(io)?;
        let now = fs::metadata(&probe).and_then(|data| data.modified()).map_err(io);
        fs::remove_file(&probe).map_err(io)?;
        now
    }
}

impl Drop for Claims {
    fn drop(&mut self) {
        if let Some((end, heart)) = self.heart.take() {
            drop(end);
            if heart.join().is_err() {
                tracing::warn!("claims: the thread that kept them alive broke off");
            }
        }
        if let Err(error) = fs::remove_file(&self.own) {
            tracing::warn!("{}: {error}", self.own.display());
        }
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        // One that another worker took over is not ours to take away.
        if self.claims.is_mine(&self.path)
            && let Err(error) = fs::remove_file(&self.path)
        {
            tracing::warn!("{}: {error}", self.path.display());
        }
    }
}

/// When a file was written last; `None` when it is gone.
fn modified(path: &Path) -> Result<Option<SystemTime>, EngineError> {
    match fs::metadata(path).and_then(|data| data.modified()) {
        Ok(time) => Ok(Some(time)),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(source) => Err(EngineError::Io { path: path.to_path_buf(), source }),
    }
}

/// Writes the worker's name over itself: the server stamps the file, and readers never see it empty.
fn write_name(file: &mut File, worker: &str) -> std::io::Result<()> {
    file.seek(SeekFrom::Start(0))?;
    file.write_all(worker.as_bytes())?;
    file.sync_all()
}
