//! What became of rows, as the workers wrote it down.
//!
//! Each worker adds lines to a file of its own, which no other writes: many that add to one file would tear each
//! other's lines on a network file system. A line that was cut off by the end of its worker counts as not written.

use std::collections::HashMap;
use std::fs::{self, File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::ledger::Merged;
use super::manifest::Row;
use super::record::{Known, Record, journals, open_behind};
use crate::base::digest::Digest;
use crate::error::EngineError;

/// All records of a manifest, and the file of this worker.
#[derive(Debug)]
pub struct Journal {
    folder: PathBuf,
    own: PathBuf,
    /// Open once something was written.
    file: Option<File>,
    /// How far each file was read.
    read: HashMap<PathBuf, u64>,
    last: HashMap<String, Known>,
}

impl Journal {
    /// Reads what there is in the folder, a ledger first; one that is not there holds nothing.
    ///
    /// # Errors
    /// Those of [`Journal::refresh`].
    pub fn open(folder: &Path, worker: &str) -> Result<Self, EngineError> {
        let own = folder.join(format!("{worker}.jsonl"));
        let Merged { known, read } = Merged::read(folder);
        let last = known.into_iter().map(|known| (known.id.clone(), known)).collect();
        let mut journal = Self { folder: folder.to_path_buf(), own, file: None, read, last };
        journal.refresh()?;
        Ok(journal)
    }

    /// Reads what was added meanwhile.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming file and line, [`EngineError::Io`].
    pub fn refresh(&mut self) -> Result<(), EngineError> {
        // What stands in this worker's own file it has in mind.
        let is_own = |path: &PathBuf| self.file.is_some() && *path == self.own;
        let others: Vec<PathBuf> = journals(&self.folder)?.into_iter().filter(|path| !is_own(path)).collect();
        others.iter().try_for_each(|path| self.read_on(path))
    }

    /// Reads the whole lines that were added to one file.
    fn read_on(&mut self, path: &Path) -> Result<(), EngineError> {
        let io = |source| EngineError::Io { path: path.to_path_buf(), source };
        let read = self.read.get(path).copied().unwrap_or(0);
        let Some((mut file, from)) = open_behind(path, read)? else { return Ok(()) };
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(io)?;
        let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        let lines: Vec<&[u8]> = bytes[..whole].split(|byte| *byte == b'\n').filter(|line| !line.is_empty()).collect();
        let records: Vec<Known> = lines.par_iter().map(|line| Known::parse(path, line)).collect::<Result<_, _>>()?;
        records.into_iter().for_each(|record| self.take(record));
        self.read.insert(path.to_path_buf(), from + whole as u64);
        Ok(())
    }

    fn take(&mut self, record: Known) {
        if self.last.get(&record.id).is_none_or(|known| known.rank() <= record.rank()) {
            self.last.insert(record.id.clone(), record);
        }
    }

    /// Adds records, on disk before it returns.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`], [`EngineError::Io`].
    pub fn add(&mut self, records: &[Record]) -> Result<(), EngineError> {
        let io = |source| EngineError::Io { path: self.own.clone(), source };
        let file = match &mut self.file {
            Some(file) => file,
            none => {
                let made = fs::create_dir_all(&self.folder)
                    .and_then(|()| OpenOptions::new().create(true).append(true).open(&self.own));
                let refuse =
                    |e: std::io::Error| EngineError::CannotCreate { path: self.own.clone(), reason: e.to_string() };
                none.insert(made.map_err(refuse)?)
            }
        };
        let mut lines = Vec::new();
        for record in records {
            serde_json::to_writer(&mut lines, record).expect("records hold nothing that JSON cannot");
            lines.push(b'\n');
        }
        // One call, so that lines are there whole or cut off at their end.
        file.write_all(&lines).and_then(|()| file.sync_data()).map_err(io)?;
        records.iter().for_each(|record| self.take(record.known()));
        Ok(())
    }

    /// What holds for each of these rows; nothing where that was at other settings.
    #[must_use]
    pub fn of_rows(&self, rows: &[Row]) -> Vec<Option<&Known>> {
        let settings: Vec<Digest> = rows.par_iter().map(Row::settings_hash).collect();
        let holds = |(row, settings): (&Row, Digest)| self.last(&row.id).filter(|last| last.settings == settings);
        rows.iter().zip(settings).map(holds).collect()
    }

    /// What holds for a row.
    #[must_use]
    pub fn last(&self, id: &str) -> Option<&Known> {
        self.last.get(id)
    }
}
