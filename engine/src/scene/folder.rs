//! What is in a folder.

use std::path::{Path, PathBuf};

use crate::error::EngineError;

/// Extensions of files that hold splats.
const SPLAT_EXTENSIONS: [&str; 7] = ["ply", "splat", "splatv", "spz", "sog", "ksplat", "glb"];

/// Names of a folder's entries, sorted.
pub(super) fn list(folder: &Path) -> Result<Vec<PathBuf>, EngineError> {
    let io_error = |source| EngineError::Io { path: folder.to_path_buf(), source };
    let entries = std::fs::read_dir(folder).map_err(io_error)?;
    let names = entries.map(|entry| entry.map(|entry| PathBuf::from(entry.file_name())));
    let mut names: Vec<PathBuf> = names.collect::<Result<_, _>>().map_err(io_error)?;
    names.sort();
    Ok(names)
}

/// Whether a file of this name holds splats, going by its extension.
pub(super) fn has_splat_extension(name: &Path) -> bool {
    let extension = name.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    extension.is_some_and(|extension| SPLAT_EXTENSIONS.contains(&extension.as_str()))
}
