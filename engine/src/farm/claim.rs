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

use crate::base::prf::fill_unpredictably;
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
        remove_dead(folder)?;
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
        if !self.is_silent(&path)? || !self.take_away(&path, &self.folder.join(format!(".{id}.takeover")))? {
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

    /// Whether the worker of a claim is silent, or dead as this machine knows; one that is gone has none.
    fn is_silent(&self, path: &Path) -> Result<bool, EngineError> {
        let Some(beaten) = modified(path)? else { return Ok(true) };
        if fs::read_to_string(path).is_ok_and(|name| is_dead(&name)) {
            return Ok(true);
        }
        let now = self.server_time()?;
        Ok(now.duration_since(beaten).unwrap_or_default() > self.beat * MISSED_BEATS)
    }

    /// Takes away the claim of a silent worker; whether it is gone. Of all who see it one at a time does so, and looks
    /// once more: whoever comes late would take away the claim of the one who was faster.
    fn take_away(&self, path: &Path, turn: &Path) -> Result<bool, EngineError> {
        let io = |source| EngineError::Io { path: turn.to_path_buf(), source };
        match fs::hard_link(&self.own, turn) {
            Ok(()) => {}
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                // One that was killed in its turn: the next who asks has one.
                if modified(turn)?.is_some() && self.is_silent(turn)? {
                    removed(turn)?;
                }
                return Ok(false);
            }
            Err(source) => return Err(io(source)),
        }
        let is_gone = self.is_silent(path).and_then(|is_silent| match is_silent {
            true => removed(path).map(|()| true),
            false => Ok(false),
        });
        removed(turn)?;
        is_gone
    }

    /// What the clock says that stamps the files.
    fn server_time(&self) -> Result<SystemTime, EngineError> {
        let probe = self.own.with_extension("clock");
        let io = |source| EngineError::Io { path: probe.clone(), source };
        let written = File::create(&probe).and_then(|mut file| {
            file.write_all(self.worker.as_bytes())?;
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

/// A name that no other process has: host, process, and a random number, because containers share both.
///
/// # Errors
/// [`EngineError::Program`] if the system has no working random source.
pub fn worker_name() -> Result<String, EngineError> {
    let mut bytes = [0; 4];
    fill_unpredictably(&mut bytes)?;
    Ok(format!("{}-{}-{:08x}", host(), std::process::id(), u32::from_le_bytes(bytes)))
}

/// This machine's name, as names of files have it.
fn host() -> String {
    let name = fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let name: String = name.trim().chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if name.is_empty() { "host".to_owned() } else { name }
}

/// Whether a worker was a process of this machine that is no longer there. Of one in another container of the same name
/// it can say so though it lives: then two workers do one row.
fn is_dead(worker: &str) -> bool {
    let mut parts = worker.split('-');
    let (Some(host), Some(process), Some(_), None) = (parts.next(), parts.next(), parts.next(), parts.next()) else {
        return false;
    };
    let is_number = process.parse::<u32>().is_ok();
    is_number && host == self::host() && Path::new("/proc/self").exists() && !Path::new("/proc").join(process).exists()
}

/// Removes what workers of this machine left that were killed.
fn remove_dead(folder: &Path) -> Result<(), EngineError> {
    let io = |source| EngineError::Io { path: folder.to_path_buf(), source };
    for entry in fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        // A worker's own files bear its name, also where it was killed before it could write it.
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let is_left = name.strip_prefix('.').is_some_and(is_dead);
        if is_left || fs::read_to_string(&path).is_ok_and(|name| is_dead(&name)) {
            removed(&path)?;
        }
    }
    Ok(())
}

/// Removes a file, unless it is gone.
fn removed(path: &Path) -> Result<(), EngineError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => {
            Err(EngineError::Io { path: path.to_path_buf(), source: error })
        }
        _ => Ok(()),
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
