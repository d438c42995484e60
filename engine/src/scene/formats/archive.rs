//! The files of a SOG archive, by name, and the archive with another one in its place.

use std::io::{Cursor, Read as _, Write as _};
use std::path::Path;

use zip::result::ZipResult;
use zip::{ZipArchive, ZipWriter};

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

    /// The archive with another content of the entry `name`; the others stay as they are packed, in their order.
    pub(super) fn with_entry(&mut self, name: &str, content: &[u8]) -> Result<Vec<u8>, EngineError> {
        let path = self.path;
        self.copy(name, content)
            .map_err(|error| bad_data(path, "archive", error, "entries that can be written into another archive"))
    }

    fn copy(&mut self, name: &str, content: &[u8]) -> ZipResult<Vec<u8>> {
        let replaced = self.zip.index_for_name(name);
        let mut copy = ZipWriter::new(Cursor::new(Vec::new()));
        copy.set_raw_comment(self.zip.comment().into())?;
        for index in 0..self.zip.len() {
            let entry = self.zip.by_index_raw(index)?;
            if Some(index) == replaced {
                copy.start_file(name, entry.options())?;
                copy.write_all(content)?;
            } else {
                copy.raw_copy_file(entry)?;
            }
        }
        Ok(copy.finish()?.into_inner())
    }

    /// Refuses archives whose entries take more bytes together than there are: a copy would hold the same bytes many
    /// times.
    pub(super) fn check_packed(&mut self, file_bytes: usize) -> Result<(), EngineError> {
        let mut packed = 0_u64;
        for index in 0..self.zip.len() {
            let entry = self.zip.by_index_raw(index);
            let entry = entry.map_err(|error| bad_data(self.path, "archive", error, "entries that can be found"))?;
            packed = packed.saturating_add(entry.compressed_size());
        }
        match packed <= file_bytes as u64 {
            true => Ok(()),
            false => Err(bad_data(self.path, "packed bytes of all entries", packed, format!("at most {file_bytes}"))),
        }
    }
}
