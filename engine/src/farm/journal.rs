//! What became of rows, as the workers wrote it down.
//!
//! Each worker adds lines to a file of its own, which no other writes: many that add to one file would tear each
//! other's lines on a network file system. A line that was cut off by the end of its worker counts as not written.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::contents::Contents;
use crate::base::digest::Digest;
use crate::base::files::bad_data;
use crate::error::EngineError;

/// Name and version of what stands in a line.
const SCHEMA: &str = "guard4d.farm-record/1";

/// What became of one attempt at a row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// `guard4d.farm-record/1`
    pub schema: String,
    /// The row's.
    pub id: String,
    /// The row's.
    pub job: String,
    /// From 1; the largest of a row tells what holds.
    pub attempt: u32,
    /// How far it came.
    pub state: State,
    /// What was to be done, [`Row::settings_hash`].
    ///
    /// [`Row::settings_hash`]: super::manifest::Row::settings_hash
    pub settings: Digest,
    /// What the input held; none for a job without one.
    pub input: Option<Digest>,
    /// What was made, by file.
    pub outputs: Contents,
    /// As if the row were a command of its own.
    pub exit_code: Option<u8>,
    /// Why it failed.
    pub error: Option<String>,
    /// How long it took.
    pub seconds: f64,
    /// Who did it: host and process.
    pub worker: String,
    /// Columns that the job does not know.
    pub notes: BTreeMap<String, String>,
    /// What the command prints with `--json`.
    pub result: Value,
}

/// How far an attempt came. Of two records of one attempt the later of these holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// It was begun.
    Running,
    /// It was asked to stop, and can go on.
    Interrupted,
    /// It failed, or its result is not good enough.
    Failed,
    /// It is done.
    Done,
}

/// All records of a manifest, and the file of this worker.
#[derive(Debug)]
pub struct Journal {
    folder: PathBuf,
    own: PathBuf,
    /// Open once something was written.
    file: Option<File>,
    /// How far each file was read.
    read: HashMap<PathBuf, u64>,
    last: HashMap<String, Record>,
}

impl Record {
    /// The beginning of an attempt.
    #[must_use]
    pub fn begun(id: &str, job: &str, attempt: u32, settings: Digest, worker: &str) -> Self {
        Self {
            schema: SCHEMA.to_owned(),
            id: id.to_owned(),
            job: job.to_owned(),
            attempt,
            state: State::Running,
            settings,
            input: None,
            outputs: Contents::default(),
            exit_code: None,
            error: None,
            seconds: 0.0,
            worker: worker.to_owned(),
            notes: BTreeMap::new(),
            result: Value::Null,
        }
    }

    /// What tells which of two records of a row holds.
    fn rank(&self) -> (u32, State) {
        (self.attempt, self.state)
    }
}

impl Journal {
    /// Reads what there is in the folder; one that is not there holds nothing.
    ///
    /// # Errors
    /// Those of [`Journal::refresh`].
    pub fn open(folder: &Path, worker: &str) -> Result<Self, EngineError> {
        let own = folder.join(format!("{worker}.jsonl"));
        let (folder, read, last) = (folder.to_path_buf(), HashMap::new(), HashMap::new());
        let mut journal = Self { folder, own, file: None, read, last };
        journal.refresh()?;
        Ok(journal)
    }

    /// Reads what was added meanwhile.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming file and line, [`EngineError::Io`].
    pub fn refresh(&mut self) -> Result<(), EngineError> {
        let io = |source| EngineError::Io { path: self.folder.clone(), source };
        let entries = match fs::read_dir(&self.folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
            Err(source) => return Err(io(source)),
        };
        let mut files: Vec<PathBuf> = Vec::new();
        for entry in entries {
            files.push(entry.map_err(io)?.path());
        }
        files.retain(|path| path.extension().is_some_and(|end| end == "jsonl"));
        files.sort();
        files.iter().try_for_each(|path| self.read_on(path))
    }

    /// Reads the whole lines that were added to one file.
    fn read_on(&mut self, path: &Path) -> Result<(), EngineError> {
        let io = |source| EngineError::Io { path: path.to_path_buf(), source };
        let from = self.read.get(path).copied().unwrap_or(0);
        let mut file = File::open(path).map_err(io)?;
        if file.metadata().map_err(io)?.len() == from {
            return Ok(());
        }
        file.seek(SeekFrom::Start(from)).map_err(io)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(io)?;
        let whole = bytes.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        for line in bytes[..whole].split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
            let bad = |got: &dyn std::fmt::Display| bad_data(path, "line", got, SCHEMA);
            let record: Record = serde_json::from_slice(line).map_err(|error| bad(&error))?;
            if record.schema != SCHEMA {
                return Err(bad(&record.schema));
            }
            self.take(record);
        }
        self.read.insert(path.to_path_buf(), from + whole as u64);
        Ok(())
    }

    fn take(&mut self, record: Record) {
        if self.last.get(&record.id).is_none_or(|known| known.rank() <= record.rank()) {
            self.last.insert(record.id.clone(), record);
        }
    }

    /// Adds a record, on disk before it returns.
    ///
    /// # Errors
    /// [`EngineError::CannotCreate`], [`EngineError::Io`].
    pub fn add(&mut self, record: Record) -> Result<(), EngineError> {
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
        let mut line = serde_json::to_vec(&record).expect("records hold nothing that JSON cannot");
        line.push(b'\n');
        // One call, so that the line is there whole or cut off at its end.
        file.write_all(&line).and_then(|()| file.sync_data()).map_err(io)?;
        *self.read.entry(self.own.clone()).or_default() += line.len() as u64;
        self.take(record);
        Ok(())
    }

    /// What holds for a row.
    #[must_use]
    pub fn last(&self, id: &str) -> Option<&Record> {
        self.last.get(id)
    }
}
