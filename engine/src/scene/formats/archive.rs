//! The files of a SOG archive, by name.

use std::io::{Cursor, Read as _};
use std::path::Path;

use zip::ZipArchive;

use crate::base::files::bad_data;
use crate::error::EngineError;

/// A ZIP archive in memory.
pub(super) struct Archive<'a> {
    path: &'a Path,
    zip: ZipArchive<Cursor<&'a [u8]>>,
}

impl<'a> Archive<'a> {
    pub(super) fn open(path: &'a Path, bytes: &'a [u8]) -> Result<Self, EngineError> {
        let zip = ZipArchive::new(Cursor::new(bytes));
        Ok(Self { path, zip: zip.map_err(|error| bad_data(path, "archive", error, "a ZIP archive"))? })
    }

    /// The content of the entry `name`, of at most `max_bytes` bytes.
    pub(super) fn read(&mut self, name: &str, max_bytes: usize) -> Result<Vec<u8>, EngineError> {
        let path = self.path;
        let bad = |got: String, expected: &str| bad_data(path, format!("entry `{name}`"), got, expected);
        let entry = self.zip.by_name(name).map_err(|error| bad(error.to_string(), "a file of the archive"))?;
        let mut bytes = Vec::new();
        let read = entry.take(max_bytes as u64 + 1).read_to_end(&mut bytes);
        read.map_err(|error| bad(error.to_string(), "a whole file"))?;
        if bytes.len() > max_bytes {
            return Err(bad(format!("more than {max_bytes} bytes"), "what the rest of the archive has need of"));
        }
        Ok(bytes)
    }
}
