//! Whether a path leads to a model at all.

use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use super::folder::{has_splat_extension, list};
use super::formats::Format;
use super::model::POINT_CLOUD;
use crate::error::EngineError;

/// Bytes at the start of a file that are enough to tell its format.
const HEAD_BYTES: u64 = 1 << 16;

/// Whether there is something at `path` that [`super::Model::open`] would take for a model, for all that may be wrong
/// with it: a trainer's output folder, a folder of splat files, or a file of a known format.
///
/// Films and folders of pictures are no models, and neither is a path that leads nowhere.
///
/// # Errors
/// [`EngineError::Io`] when what is there cannot be read.
pub fn is_model(path: &Path) -> Result<bool, EngineError> {
    if path.is_dir() {
        return Ok(path.join(POINT_CLOUD).exists() || list(path)?.iter().any(|name| has_splat_extension(name)));
    }
    if !path.is_file() {
        return Ok(false);
    }
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(HEAD_BYTES).read_to_end(&mut head));
    read.map_err(|source| EngineError::Io { path: path.to_owned(), source })?;
    Ok(Format::recognise(path, &head).is_ok())
}
