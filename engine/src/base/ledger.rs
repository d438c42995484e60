//! Rows that outlast a broken-off run: a CSV file that grows by one line per row.

use std::fs;
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::files::{bad_data, read_file};
use super::output::{AtomicFile, Existing};
use crate::error::EngineError;

/// The file and what it holds, a line for each `R`.
///
/// `R` is a flat struct, whose fields are the columns. Its default value is never written: it only tells their names.
#[derive(Debug)]
pub struct Ledger<R> {
    path: PathBuf,
    rows: Vec<R>,
}

impl<R: Default + Serialize + DeserializeOwned> Ledger<R> {
    /// Opens or creates a file. A last line that was cut off is dropped.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when an existing file has other columns; [`EngineError::Io`].
    pub fn open(path: &Path) -> Result<Self, EngineError> {
        let text = match fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == ErrorKind::NotFound => String::new(),
            Err(source) => return Err(EngineError::Io { path: path.to_owned(), source }),
        };
        let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
        let bad =
            |got: &dyn std::fmt::Display| bad_data(path, "rows", got, "the columns of this version, or another file");
        let head = head::<R>()?;
        // A line that lacks a column still makes a row, and the next one to be added would not fit it.
        if let Some(first) = whole.split_inclusive('\n').next().filter(|first| **first != head) {
            return Err(bad(&first.trim_end()));
        }
        let mut reader = csv::Reader::from_reader(whole.as_bytes());
        let rows = reader.deserialize().collect::<Result<Vec<R>, _>>().map_err(|error| bad(&error))?;
        if whole.is_empty() || whole.len() != text.len() {
            let kept = if whole.is_empty() { head } else { whole.to_owned() };
            AtomicFile::write(path, Existing::Replace, kept.as_bytes())?;
        }
        Ok(Self { path: path.to_owned(), rows })
    }

    /// Adds rows, on disk before it returns.
    ///
    /// # Errors
    /// [`EngineError::Io`] naming the file.
    pub fn append(&mut self, rows: Vec<R>) -> Result<(), EngineError> {
        let text = lines(&rows, Head::Without)?;
        let written = fs::OpenOptions::new().append(true).open(&self.path).and_then(|mut file| {
            file.write_all(text.as_bytes())?;
            file.sync_data()
        });
        written.map_err(|source| EngineError::Io { path: self.path.clone(), source })?;
        self.rows.extend(rows);
        Ok(())
    }

    /// All rows, the oldest first.
    #[must_use]
    pub fn rows(&self) -> &[R] {
        &self.rows
    }

    /// The newest row that `is_it` holds for: a later row corrects an earlier one.
    pub fn newest(&self, is_it: impl Fn(&R) -> bool) -> Option<&R> {
        self.rows.iter().rev().find(|row| is_it(row))
    }
}

/// Reads a table that is not added to. Its columns may stand in any order; those of optional figures may be missing.
///
/// # Errors
/// [`EngineError::MissingInput`] without the file, [`EngineError::BadData`] when a line is no such row.
pub fn read<R: DeserializeOwned>(path: &Path, expected: &str) -> Result<Vec<R>, EngineError> {
    let bytes = read_file(path, expected)?;
    let rows = csv::Reader::from_reader(bytes.as_slice()).into_deserialize().collect::<Result<_, _>>();
    rows.map_err(|error| bad_data(path, "rows", error, expected))
}

/// Whether the names of the columns stand above the rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Head {
    /// They do.
    With,
    /// They do not.
    Without,
}

/// Rows as CSV. Without rows there is no head either.
///
/// # Errors
/// [`EngineError::Io`] for rows that are not flat.
pub fn lines<R: Serialize>(rows: &[R], head: Head) -> Result<String, EngineError> {
    let mut writer = csv::WriterBuilder::new().has_headers(head == Head::With).from_writer(Vec::new());
    let written = rows.iter().try_for_each(|row| writer.serialize(row)).map_err(std::io::Error::from);
    let bytes = written.and_then(|()| writer.into_inner().map_err(|error| error.into_error()));
    let text = bytes.and_then(|bytes| String::from_utf8(bytes).map_err(std::io::Error::other));
    text.map_err(|source| EngineError::Io { path: "rows of a ledger".into(), source })
}

/// The file's first line.
fn head<R: Default + Serialize>() -> Result<String, EngineError> {
    let with_one = lines(&[R::default()], Head::With)?;
    Ok(with_one[..=with_one.find('\n').unwrap_or(0)].to_owned())
}
