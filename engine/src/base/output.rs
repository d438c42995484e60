//! Outputs that appear whole or not at all.
//!
//! Everything is written beside its destination under the name `.NAME.partial-PID`, flushed to disk, and renamed.
//! A run that fails or is stopped removes its partial output; one that is killed leaves it under that name.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use crate::error::EngineError;

/// Most partial outputs of one name and process id, counting those that killed runs left behind.
const MAX_PARTIALS: u32 = 64;

/// What to do when the destination exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Refuse with [`EngineError::CannotCreate`].
    Refuse,
    /// Replace it when the new output is complete.
    Replace,
}

/// A folder that is filled under a partial name and takes its place on [`AtomicDir::commit`].
#[derive(Debug)]
pub struct AtomicDir {
    partial: Partial,
}

/// A file that is written under a partial name and takes its place on [`AtomicFile::commit`].
#[derive(Debug)]
pub struct AtomicFile {
    file: File,
    partial: Partial,
}

impl AtomicDir {
    /// Creates the empty partial folder, and the parents of `target` if they are missing.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] if `target` exists and may not be replaced, or if the place is not writable.
    pub fn create(target: &Path, existing: Existing) -> Result<Self, EngineError> {
        let (partial, ()) = Partial::create(target, existing, |path| fs::create_dir(path))?;
        Ok(Self { partial })
    }

    /// The same for secrets: where the system knows owners of files, nobody else can look into it.
    ///
    /// # Errors
    /// Those of [`AtomicDir::create`].
    pub fn create_private(target: &Path, existing: Existing) -> Result<Self, EngineError> {
        let (partial, ()) = Partial::create(target, existing, |path| private_dir().create(path))?;
        Ok(Self { partial })
    }

    /// The partial folder, to be filled.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.partial.path
    }

    /// Flushes every file of the folder to disk and renames it to its destination.
    ///
    /// # Errors
    /// [`EngineError::Io`] if flushing or renaming fails; [`EngineError::CannotCreate`] if the destination appeared
    /// meanwhile and may not be replaced. The partial folder is removed in both cases.
    pub fn commit(self) -> Result<(), EngineError> {
        sync_tree(&self.partial.path)?;
        self.partial.commit()
    }
}

impl AtomicFile {
    /// Creates the empty partial file, and the parents of `target` if they are missing.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`] if `target` exists and may not be replaced, or if the place is not writable.
    pub fn create(target: &Path, existing: Existing) -> Result<Self, EngineError> {
        let (partial, file) = Partial::create(target, existing, |path| File::create_new(path))?;
        Ok(Self { file, partial })
    }

    /// The same for a secret: where the system knows owners of files, nobody else can read it, from its first byte on.
    ///
    /// # Errors
    /// Those of [`AtomicFile::create`].
    pub fn create_private(target: &Path, existing: Existing) -> Result<Self, EngineError> {
        let (partial, file) = Partial::create(target, existing, create_private_file)?;
        Ok(Self { file, partial })
    }

    /// Writes `bytes` to `target` as one atomic output that only its owner can read.
    ///
    /// # Errors
    /// Those of [`AtomicFile::create`] and [`AtomicFile::commit`].
    pub fn write_private(target: &Path, existing: Existing, bytes: &[u8]) -> Result<(), EngineError> {
        Self::create_private(target, existing)?.finish(bytes)
    }

    /// Writes `bytes` to `target` as one atomic output.
    ///
    /// # Errors
    /// Those of [`AtomicFile::create`] and [`AtomicFile::commit`].
    pub fn write(target: &Path, existing: Existing, bytes: &[u8]) -> Result<(), EngineError> {
        Self::create(target, existing)?.finish(bytes)
    }

    /// Writes `bytes` and commits.
    ///
    /// # Errors
    /// [`EngineError::Io`] if writing fails; those of [`Self::commit`].
    pub fn finish(mut self, bytes: &[u8]) -> Result<(), EngineError> {
        let written = self.file.write_all(bytes);
        written.map_err(|source| io_error(&self.partial.path, source))?;
        self.commit()
    }

    /// The partial file's path, for programs that open it themselves.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.partial.path
    }

    /// The open partial file, to be written.
    pub fn file(&mut self) -> &mut File {
        &mut self.file
    }

    /// Flushes the file to disk and renames it to its destination.
    ///
    /// # Errors
    /// [`EngineError::Io`] if flushing or renaming fails; [`EngineError::CannotCreate`] if the destination appeared
    /// meanwhile and may not be replaced. The partial file is removed in both cases.
    pub fn commit(self) -> Result<(), EngineError> {
        let synced = self.file.sync_all();
        synced.map_err(|source| io_error(&self.partial.path, source))?;
        self.partial.commit()
    }
}

/// A path that is removed on drop unless it was renamed to its target.
#[derive(Debug)]
struct Partial {
    path: PathBuf,
    target: PathBuf,
    existing: Existing,
    committed: bool,
}

impl Partial {
    fn create<T>(
        target: &Path,
        existing: Existing,
        make: impl Fn(&Path) -> std::io::Result<T>,
    ) -> Result<(Self, T), EngineError> {
        let refuse = |reason: String| EngineError::CannotCreate { path: target.to_path_buf(), reason };
        check_free(target, existing)?;
        let parent = parent_of(target);
        fs::create_dir_all(parent).map_err(|e| refuse(format!("{}: {e}", parent.display())))?;
        for attempt in 0..MAX_PARTIALS {
            let path = sibling(target, "partial", attempt)?;
            match make(&path) {
                Ok(made) => {
                    let partial = Self { path, target: target.to_path_buf(), existing, committed: false };
                    return Ok((partial, made));
                }
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => return Err(refuse(error.to_string())),
            }
        }
        Err(refuse(format!("{MAX_PARTIALS} partial outputs stand beside it")))
    }

    fn commit(mut self) -> Result<(), EngineError> {
        check_free(&self.target, self.existing)?;
        if self.existing == Existing::Refuse && self.path.is_file() {
            // A rename would replace what somebody else puts there meanwhile; a second name for the file does not.
            match fs::hard_link(&self.path, &self.target) {
                Ok(()) => {
                    self.committed = true;
                    fs::remove_file(&self.path).map_err(|source| io_error(&self.path, source))?;
                    return sync_dir(parent_of(&self.target));
                }
                Err(error) if error.kind() == ErrorKind::AlreadyExists => return Err(taken(&self.target)),
                // Some file systems know no second names.
                Err(_) => {}
            }
        }
        let old = self.move_old_away()?;
        if let Err(source) = fs::rename(&self.path, &self.target) {
            if let Some(old) = old {
                fs::rename(&old, &self.target).map_err(|error| io_error(&old, error))?;
            }
            return Err(io_error(&self.target, source));
        }
        self.committed = true;
        if let Some(old) = old {
            fs::remove_dir_all(&old).map_err(|source| io_error(&old, source))?;
        }
        sync_dir(parent_of(&self.target))
    }

    /// Moves an existing folder out of the way, because a rename replaces only files.
    fn move_old_away(&self) -> Result<Option<PathBuf>, EngineError> {
        if !self.target.is_dir() {
            return Ok(None);
        }
        let mut old = Err(io_error(&self.target, ErrorKind::AlreadyExists.into()));
        for attempt in 0..MAX_PARTIALS {
            let path = sibling(&self.target, "old", attempt)?;
            if !path.exists() {
                let renamed = fs::rename(&self.target, &path);
                old = renamed.map_err(|source| io_error(&self.target, source)).map(|()| path);
                break;
            }
        }
        old.map(Some)
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        if self.committed {
            return;
        }
        let removed = match self.path.is_dir() {
            true => fs::remove_dir_all(&self.path),
            false => fs::remove_file(&self.path),
        };
        if let Err(error) = removed {
            tracing::warn!(path = %self.path.display(), %error, "partial output was not removed");
        }
    }
}

/// A folder for secrets, with its parents: where the system knows owners of files, nobody else can look into it.
///
/// # Errors
/// [`EngineError::CannotCreate`] if the place is not writable.
pub fn create_private_dir(path: &Path) -> Result<(), EngineError> {
    private_dir()
        .recursive(true)
        .create(path)
        .map_err(|error| EngineError::CannotCreate { path: path.to_path_buf(), reason: error.to_string() })
}

fn private_dir() -> fs::DirBuilder {
    let mut builder = fs::DirBuilder::new();
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder
}

fn create_private_file(path: &Path) -> std::io::Result<File> {
    let mut options = File::options();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)
}

fn io_error(path: &Path, source: std::io::Error) -> EngineError {
    EngineError::Io { path: path.to_path_buf(), source }
}

fn check_free(target: &Path, existing: Existing) -> Result<(), EngineError> {
    if existing == Existing::Refuse && target.symlink_metadata().is_ok() {
        return Err(taken(target));
    }
    Ok(())
}

fn taken(target: &Path) -> EngineError {
    let reason = "it exists; --overwrite replaces it".to_owned();
    EngineError::CannotCreate { path: target.to_path_buf(), reason }
}

fn parent_of(target: &Path) -> &Path {
    match target.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    }
}

/// Removes what killed runs left of `target` under partial names. Nobody else may be writing it.
///
/// # Errors
/// [`EngineError::Io`] naming what cannot be read or removed.
pub fn remove_partials(target: &Path) -> Result<(), EngineError> {
    let (parent, Some(name)) = (parent_of(target), target.file_name()) else { return Ok(()) };
    let entries = match fs::read_dir(parent) {
        Ok(entries) => entries,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        Err(source) => return Err(io_error(parent, source)),
    };
    let kinds = ["partial", "old"].map(|kind| format!(".{}.{kind}-", name.to_string_lossy()));
    for entry in entries {
        let path = entry.map_err(|source| io_error(parent, source))?.path();
        let found = path.file_name().unwrap_or_default().to_string_lossy();
        if !kinds.iter().any(|kind| found.starts_with(kind.as_str())) {
            continue;
        }
        let removed = if path.is_dir() { fs::remove_dir_all(&path) } else { fs::remove_file(&path) };
        removed.map_err(|source| io_error(&path, source))?;
    }
    Ok(())
}

/// `.NAME.KIND-PID` beside `target`, with a number behind it from the second attempt on.
fn sibling(target: &Path, kind: &str, attempt: u32) -> Result<PathBuf, EngineError> {
    let name = target.file_name().ok_or_else(|| EngineError::CannotCreate {
        path: target.to_path_buf(),
        reason: "it names no file or folder".to_owned(),
    })?;
    let mut sibling = OsString::from(".");
    sibling.push(name);
    sibling.push(format!(".{kind}-{}", std::process::id()));
    if attempt > 0 {
        sibling.push(format!("-{attempt}"));
    }
    Ok(parent_of(target).join(sibling))
}

/// Flushes the files of a folder, its subfolders and their directories.
fn sync_tree(folder: &Path) -> Result<(), EngineError> {
    for entry in fs::read_dir(folder).map_err(|source| io_error(folder, source))? {
        let path = entry.map_err(|source| io_error(folder, source))?.path();
        if path.is_dir() {
            sync_tree(&path)?;
        } else {
            let synced = File::open(&path).and_then(|file| file.sync_all());
            synced.map_err(|source| io_error(&path, source))?;
        }
    }
    sync_dir(folder)
}

/// Makes the names in `folder` durable, on systems where folders can be flushed.
fn sync_dir(folder: &Path) -> Result<(), EngineError> {
    if cfg!(unix) {
        let synced = File::open(folder).and_then(|file| file.sync_all());
        synced.map_err(|source| io_error(folder, source))?;
    }
    Ok(())
}
