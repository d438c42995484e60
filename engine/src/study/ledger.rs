//! Rows that outlast a broken-off run: a CSV file that grows by one line per reading.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use super::row::Row;
use crate::error::EngineError;
use crate::output::{AtomicFile, Existing};

/// The file and what it holds.
#[derive(Debug)]
pub struct Ledger {
    path: PathBuf,
    rows: Vec<Row>,
}

impl Ledger {
    /// Opens or creates a file. A last line that was cut off is dropped.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when an existing file has other columns; [`EngineError::Io`].
    pub fn open(path: &Path) -> Result<Self, EngineError> {
        let io = |source| EngineError::Io { path: path.to_owned(), source };
        let text = match fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(source) => return Err(io(source)),
        };
        let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
        let bad = |what: String| EngineError::BadData {
            path: path.to_owned(),
            field: "rows".to_owned(),
            got: what,
            expected: "the columns of this version, or another --out".to_owned(),
        };
        let head = Row::head()?;
        // A line that lacks a column still makes a row, and the next one to be added would not fit it.
        if let Some(first) = whole.split_inclusive('\n').next().filter(|first| **first != head) {
            return Err(bad(first.trim_end().to_owned()));
        }
        let mut reader = csv::Reader::from_reader(whole.as_bytes());
        let rows = reader.deserialize().collect::<Result<Vec<Row>, _>>().map_err(|error| bad(error.to_string()))?;
        if whole.is_empty() || whole.len() != text.len() {
            let kept = if whole.is_empty() { head } else { whole.to_owned() };
            if let Some(folder) = path.parent() {
                fs::create_dir_all(folder).map_err(io)?;
            }
            AtomicFile::write(path, Existing::Replace, kept.as_bytes())?;
        }
        Ok(Self { path: path.to_owned(), rows })
    }

    /// Adds rows, on disk before it returns.
    ///
    /// # Errors
    /// [`EngineError::Io`] naming the file.
    pub fn append(&mut self, rows: Vec<Row>) -> Result<(), EngineError> {
        let text = Row::lines(&rows)?;
        let written = fs::OpenOptions::new().append(true).open(&self.path).and_then(|mut file| {
            file.write_all(text.as_bytes())?;
            file.sync_data()
        });
        written.map_err(|source| EngineError::Io { path: self.path.clone(), source })?;
        self.rows.extend(rows);
        Ok(())
    }

    /// The newest row of an embedding's reading.
    #[must_use]
    pub fn find(&self, embedding: &str, take: &str) -> Option<&Row> {
        self.rows.iter().rev().find(|row| row.embedding == embedding && row.take == take)
    }
}
