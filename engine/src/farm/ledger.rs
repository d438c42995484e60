//! All records of a manifest in one SQLite database, to be asked and passed on.
//!
//! It is made of the records, and can be made of them again. Whoever merges works on a copy that takes the database's
//! place: so it is never written by two, on whatever file system.

use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};

use rusqlite::{Connection, OpenFlags, Transaction, params};
use serde::Serialize;

use super::manifest::Manifest;
use super::record::{DEVICE_BYTES, Known, Record, Schema, State, journals, open_behind};
use crate::base::digest::Digest;
use crate::base::files::bad_data;
use crate::base::output::{AtomicFile, Existing};
use crate::error::EngineError;

/// Version of the tables, SQLite's `user_version`.
const VERSION: i64 = 2;
/// Most attempts that a timeline shows.
const MAX_SPANS: usize = 2000;

/// One row for each attempt. Of a row of the manifest the view `rows` shows the attempt that holds.
const TABLES: &str = "
CREATE TABLE attempts (
    id TEXT NOT NULL, attempt INTEGER NOT NULL, job TEXT NOT NULL, state TEXT NOT NULL, settings TEXT NOT NULL,
    input TEXT, outputs TEXT NOT NULL, exit_code INTEGER, error TEXT, seconds REAL NOT NULL, ended_unix_s REAL,
    worker TEXT NOT NULL, notes TEXT NOT NULL, result TEXT NOT NULL, rank INTEGER NOT NULL, outputs_hash TEXT NOT NULL,
    device_bytes INTEGER,
    PRIMARY KEY (id, attempt)
) WITHOUT ROWID;
CREATE TABLE sources (file TEXT PRIMARY KEY, bytes INTEGER NOT NULL) WITHOUT ROWID;
CREATE VIEW rows AS SELECT * FROM attempts AS one
    WHERE attempt = (SELECT max(attempt) FROM attempts WHERE id = one.id);
";

/// A row's record, whatever there was before of the same attempt: what came later in the attempt holds.
const PUT: &str = "
INSERT INTO attempts VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17)
    ON CONFLICT (id, attempt) DO UPDATE SET
        job = excluded.job, state = excluded.state, settings = excluded.settings, input = excluded.input,
        outputs = excluded.outputs, exit_code = excluded.exit_code, error = excluded.error,
        seconds = excluded.seconds, ended_unix_s = excluded.ended_unix_s, worker = excluded.worker,
        notes = excluded.notes, result = excluded.result, rank = excluded.rank,
        outputs_hash = excluded.outputs_hash, device_bytes = excluded.device_bytes
    WHERE excluded.rank >= rank";

/// The database, open to be read.
#[derive(Debug)]
pub struct Ledger {
    path: PathBuf,
    connection: Connection,
}

/// A job's done rows.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JobFigures {
    /// The job.
    pub job: String,
    /// Rows that are done.
    pub done: u64,
    /// Together, seconds.
    pub seconds: f64,
    /// Of one row at the median, seconds.
    pub median_s: f64,
    /// Of the slowest, seconds.
    pub most_s: f64,
}

/// A mark that was embedded, as its command measured it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mark {
    /// The row's.
    pub id: String,
    /// Where it lies, relative to the manifest.
    pub output: String,
    /// Share of bits that are read.
    pub bit_accuracy: f64,
    /// Against the unmarked film, over whole frames.
    pub psnr_db: Option<f64>,
    /// How long it took.
    pub seconds: f64,
}

/// When an attempt ran, and who did it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Span {
    /// The row's.
    pub id: String,
    /// Host and process.
    pub worker: String,
    /// Since 1970, by the worker's clock.
    pub ended_unix_s: f64,
    /// How long it took.
    pub seconds: f64,
    /// How it ended.
    pub is_done: bool,
}

impl Ledger {
    /// Where a manifest's ledger is.
    #[must_use]
    pub fn path_of(manifest: &Manifest) -> PathBuf {
        path_in(&manifest.state())
    }

    /// Adds what the workers wrote down since the last time, and opens it.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for a database that is not one of these, and for lines that are no records;
    /// [`EngineError::CannotCreate`], [`EngineError::Io`].
    pub fn merge(manifest: &Manifest) -> Result<Self, EngineError> {
        let path = Self::path_of(manifest);
        let copy = AtomicFile::create(&path, Existing::Replace)?;
        if path.exists() && !is_older(&path) {
            fs::copy(&path, copy.path()).map_err(|source| EngineError::Io { path: path.clone(), source })?;
        }
        let is_new = fs::metadata(copy.path()).is_ok_and(|data| data.len() == 0);
        fill(copy.path(), is_new, &journals(&manifest.state())?).map_err(|cause| cause.told(&path))?;
        copy.commit()?;
        Self::open(&path)
    }

    /// Opens it to be read.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`] where there is none; [`EngineError::BadData`] for another database.
    pub fn open(path: &Path) -> Result<Self, EngineError> {
        if !path.is_file() {
            let expected = "the ledger that `farm report` makes".to_owned();
            return Err(EngineError::MissingInput { path: path.to_path_buf(), expected });
        }
        let open = || {
            let connection = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
            check_version(&connection)?;
            Ok(connection)
        };
        let connection = open().map_err(|cause: Cause| cause.told(path))?;
        Ok(Self { path: path.to_path_buf(), connection })
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Done rows by job.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for a broken database.
    pub fn jobs(&self) -> Result<Vec<JobFigures>, EngineError> {
        let mut seconds: BTreeMap<String, Vec<f64>> = BTreeMap::new();
        let sql = "SELECT job, seconds FROM rows WHERE state = 'done' ORDER BY seconds";
        for (job, taken) in self.all(sql, |row| Ok((row.get::<_, String>(0)?, row.get(1)?)))? {
            seconds.entry(job).or_default().push(taken);
        }
        let figures = |(job, seconds): (String, Vec<f64>)| JobFigures {
            job,
            done: seconds.len() as u64,
            seconds: seconds.iter().sum(),
            median_s: seconds[seconds.len() / 2],
            most_s: seconds[seconds.len() - 1],
        };
        Ok(seconds.into_iter().map(figures).collect())
    }

    /// Embedded marks, those that are read worst first.
    ///
    /// # Errors
    /// Those of [`Self::jobs`].
    pub fn marks(&self, manifest: &Manifest) -> Result<Vec<Mark>, EngineError> {
        let outputs: HashMap<&str, &str> =
            manifest.rows().iter().map(|row| (row.id.as_str(), row.output.as_str())).collect();
        let sql =
            "SELECT id, json_extract(result, '$.marked'), json_extract(result, '$.psnr.mean_of_views_db'), seconds
                   FROM rows WHERE job = 'embed' AND json_extract(result, '$.marked') IS NOT NULL ORDER BY 2, id";
        let marks = self.all(sql, |row| {
            let id: String = row.get(0)?;
            let output = outputs.get(id.as_str()).copied().unwrap_or_default().to_owned();
            Ok(Mark { id, output, bit_accuracy: row.get(1)?, psnr_db: row.get(2)?, seconds: row.get(3)? })
        })?;
        Ok(marks.into_iter().filter(|mark| !mark.output.is_empty()).collect())
    }

    /// When attempts ran, the latest of them, in the order of their ends.
    ///
    /// # Errors
    /// Those of [`Self::jobs`].
    pub fn spans(&self) -> Result<Vec<Span>, EngineError> {
        let sql = format!(
            "SELECT id, worker, ended_unix_s, seconds, state = 'done' FROM attempts
             WHERE ended_unix_s IS NOT NULL ORDER BY ended_unix_s DESC, id LIMIT {MAX_SPANS}"
        );
        let mut spans = self.all(&sql, |row| {
            let (id, worker, ended_unix_s) = (row.get(0)?, row.get(1)?, row.get(2)?);
            Ok(Span { id, worker, ended_unix_s, seconds: row.get(3)?, is_done: row.get(4)? })
        })?;
        spans.reverse();
        Ok(spans)
    }

    /// The attempts that hold, as a table: what a spreadsheet opens.
    ///
    /// # Errors
    /// Those of [`Self::jobs`].
    pub fn csv(&self) -> Result<Vec<u8>, EngineError> {
        const COLUMNS: [&str; 9] =
            ["id", "job", "state", "attempt", "exit_code", "seconds", "error", "worker", "notes"];
        let sql = format!("SELECT {} FROM rows ORDER BY id", COLUMNS.join(", "));
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(COLUMNS).expect("memory takes it");
        let lines = self.all(&sql, |row| {
            (0..COLUMNS.len()).map(|at| row.get_ref(at).map(as_text)).collect::<rusqlite::Result<Vec<String>>>()
        })?;
        lines.iter().for_each(|line| writer.write_record(line).expect("memory takes it"));
        Ok(writer.into_inner().expect("memory takes it"))
    }

    fn all<T>(
        &self,
        sql: &str,
        read: impl FnMut(&rusqlite::Row<'_>) -> rusqlite::Result<T>,
    ) -> Result<Vec<T>, EngineError> {
        let ask = || self.connection.prepare(sql)?.query_map([], read)?.collect::<rusqlite::Result<Vec<T>>>();
        ask().map_err(|error| Cause::Database(error).told(&self.path))
    }
}

/// What a ledger says of each row, and how far it has read each worker's records.
#[derive(Debug, Default)]
pub(super) struct Merged {
    pub(super) known: Vec<Known>,
    pub(super) read: HashMap<PathBuf, u64>,
}

impl Merged {
    /// Reads the ledger in a folder of records. Where there is none, or none that can be read, the records say all.
    pub(super) fn read(folder: &Path) -> Self {
        let path = path_in(folder);
        if !path.is_file() {
            return Self::default();
        }
        Self::of(&path, folder).unwrap_or_else(|cause| {
            tracing::warn!(error = %cause.told(&path), "the ledger is left aside");
            Self::default()
        })
    }

    fn of(path: &Path, folder: &Path) -> Result<Self, Cause> {
        let connection = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY)?;
        check_version(&connection)?;
        let mut asked = connection.prepare(
            "SELECT id, attempt, rank, settings, input, outputs_hash, exit_code, error, seconds, device_bytes
             FROM attempts ORDER BY id, attempt",
        )?;
        let mut known: Vec<Known> = Vec::new();
        let mut rows = asked.query([])?;
        while let Some(row) = rows.next()? {
            let attempt = known_of(row)?;
            // The latest of a row holds, and comes last.
            match known.last_mut().filter(|last| last.id == attempt.id) {
                Some(last) => *last = attempt,
                None => known.push(attempt),
            }
        }
        let mut asked = connection.prepare("SELECT file, bytes FROM sources")?;
        let sources = asked.query_map([], |row| Ok((folder.join(row.get::<_, String>(0)?), row.get(1)?)))?;
        Ok(Self { known, read: sources.collect::<rusqlite::Result<_>>()? })
    }
}

fn known_of(row: &rusqlite::Row<'_>) -> rusqlite::Result<Known> {
    let hash = |text: String| Digest::from_hex(&text).ok_or(rusqlite::Error::InvalidColumnName(text));
    let rank: usize = row.get(2)?;
    Ok(Known {
        schema: Schema,
        id: row.get(0)?,
        attempt: row.get(1)?,
        state: *State::ALL.get(rank).ok_or(rusqlite::Error::IntegralValueOutOfRange(2, rank as i64))?,
        settings: hash(row.get(3)?)?,
        input: row.get::<_, Option<String>>(4)?.map(hash).transpose()?,
        outputs: hash(row.get(5)?)?,
        exit_code: row.get(6)?,
        error: row.get(7)?,
        seconds: row.get(8)?,
        device_bytes: row.get(9)?,
    })
}

fn path_in(folder: &Path) -> PathBuf {
    folder.join("ledger.sqlite")
}

/// Whether a ledger is one of an older version, whose records are read again.
fn is_older(path: &Path) -> bool {
    let version = |connection: Connection| connection.query_row("PRAGMA user_version", [], |row| row.get::<_, i64>(0));
    let version = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY).and_then(version);
    version.is_ok_and(|version| (1..VERSION).contains(&version))
}

/// Why a ledger cannot be made or read.
enum Cause {
    Database(rusqlite::Error),
    Version(i64),
    Other(EngineError),
}

impl From<rusqlite::Error> for Cause {
    fn from(error: rusqlite::Error) -> Self {
        Self::Database(error)
    }
}

impl From<EngineError> for Cause {
    fn from(error: EngineError) -> Self {
        Self::Other(error)
    }
}

impl Cause {
    fn told(self, path: &Path) -> EngineError {
        let expected = format!("a ledger of version {VERSION}; it can be removed, and is made again from the records");
        match self {
            Self::Other(error) => error,
            Self::Database(error) => bad_data(path, "database", error, expected),
            Self::Version(version) => bad_data(path, "user_version", version, expected),
        }
    }
}

fn check_version(connection: &Connection) -> Result<(), Cause> {
    let version: i64 = connection.query_row("PRAGMA user_version", [], |row| row.get(0))?;
    if version == VERSION { Ok(()) } else { Err(Cause::Version(version)) }
}

/// Adds to a database what its journals have that it has not read.
fn fill(path: &Path, is_new: bool, journals: &[PathBuf]) -> Result<(), Cause> {
    let mut connection = Connection::open(path)?;
    // Nobody else knows of this copy, and a copy that breaks off is thrown away.
    connection.pragma_update(None, "journal_mode", "OFF")?;
    connection.pragma_update(None, "synchronous", "OFF")?;
    if is_new {
        connection.execute_batch(TABLES)?;
        connection.pragma_update(None, "user_version", VERSION)?;
    }
    check_version(&connection)?;
    let transaction = connection.transaction()?;
    for journal in journals {
        take_journal(&transaction, journal)?;
    }
    transaction.commit()?;
    Ok(())
}

/// Takes the whole lines that were added to a journal.
fn take_journal(transaction: &Transaction<'_>, path: &Path) -> Result<(), Cause> {
    let io = |source| EngineError::Io { path: path.to_path_buf(), source };
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let mut asked = transaction.prepare("SELECT bytes FROM sources WHERE file = ?1")?;
    let read: u64 = asked.query_map([&name], |row| row.get(0))?.next().transpose()?.unwrap_or(0);
    let Some((file, mut at)) = open_behind(path, read)? else { return Ok(()) };
    let mut put = transaction.prepare(PUT)?;
    let (mut reader, mut line) = (BufReader::new(file), Vec::new());
    while reader.read_until(b'\n', &mut line).map_err(io)? > 0 && line.ends_with(b"\n") {
        let record = Record::parse(path, &line)?;
        at += line.len() as u64;
        line.clear();
        put.execute(params![
            record.id,
            record.attempt,
            record.job,
            name_of(record.state),
            record.settings.to_string(),
            record.input.map(|input| input.to_string()),
            serde_json::to_string(&record.outputs).expect("texts are JSON"),
            record.exit_code,
            record.error,
            record.seconds,
            record.ended_unix_s,
            record.worker,
            serde_json::to_string(&record.notes).expect("texts are JSON"),
            record.result.to_string(),
            record.state as u8,
            record.outputs.digest().to_string(),
            record.result[DEVICE_BYTES].as_u64(),
        ])?;
    }
    transaction.prepare("INSERT OR REPLACE INTO sources VALUES (?1, ?2)")?.execute(params![name, at])?;
    Ok(())
}

/// A state as the records write it.
const fn name_of(state: State) -> &'static str {
    match state {
        State::Running => "running",
        State::Interrupted => "interrupted",
        State::Failed => "failed",
        State::Done => "done",
    }
}

fn as_text(value: rusqlite::types::ValueRef<'_>) -> String {
    use rusqlite::types::ValueRef::{Blob, Integer, Null, Real, Text};
    match value {
        Null => String::new(),
        Integer(number) => number.to_string(),
        Real(number) => number.to_string(),
        Text(bytes) | Blob(bytes) => String::from_utf8_lossy(bytes).into_owned(),
    }
}
