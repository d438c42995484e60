//! Files as they are read, and errors about what is in them.

use std::fmt::Display;
use std::path::Path;

use crate::error::EngineError;

/// A [`EngineError::BadData`] about `field` of the file at `path`.
pub fn bad_data(path: &Path, field: impl Display, got: impl Display, expected: impl Display) -> EngineError {
    EngineError::BadData {
        path: path.to_path_buf(),
        field: field.to_string(),
        got: got.to_string(),
        expected: expected.to_string(),
    }
}

/// Reads a whole regular file; `expected` says what should have been there.
///
/// # Errors
/// [`EngineError::MissingInput`] if nothing is there, [`EngineError::BadData`] for a folder, pipe or
/// device, [`EngineError::Io`] if reading fails.
pub fn read_file(path: &Path, expected: &str) -> Result<Vec<u8>, EngineError> {
    let io_error = |source: std::io::Error| match source.kind() {
        std::io::ErrorKind::NotFound => {
            EngineError::MissingInput { path: path.to_path_buf(), expected: expected.to_owned() }
        }
        _ => EngineError::Io { path: path.to_path_buf(), source },
    };
    if !std::fs::metadata(path).map_err(io_error)?.is_file() {
        return Err(bad_data(path, "file type", "not a regular file", expected));
    }
    std::fs::read(path).map_err(io_error)
}
