//! What is written down about one attempt at a row, and what of it is kept in mind.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt;
use std::fs::{self, File};
use std::io::{ErrorKind, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use serde::de::{self, IgnoredAny, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;

use super::contents::Contents;
use crate::base::digest::Digest;
use crate::base::files::bad_data;
use crate::error::EngineError;

/// Name and version of what stands in a line.
const SCHEMA: &str = "guard4d.farm-record/1";
/// Where the result of a command that needs a device says how much memory it took.
pub(super) const DEVICE_BYTES: &str = "peak_memory_bytes";

/// What became of one attempt at a row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// `guard4d.farm-record/1`
    #[serde(deserialize_with = "as_this_schema")]
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
    /// When it ended, seconds since 1970 by the worker's clock; none while it runs. For people alone: clocks differ.
    #[serde(default)]
    pub ended_unix_s: Option<f64>,
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

impl State {
    /// A row that failed is not tried again by itself.
    #[must_use]
    pub const fn is_over(self) -> bool {
        matches!(self, Self::Failed | Self::Done)
    }
}

/// What is kept in mind of a record: a manifest may have a million rows.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Known {
    pub(super) schema: Schema,
    /// The row's.
    pub id: String,
    /// From 1.
    pub attempt: u32,
    /// How far it came.
    pub state: State,
    /// What was to be done.
    pub settings: Digest,
    /// What the input held.
    pub input: Option<Digest>,
    /// What was made, as one hash.
    #[serde(deserialize_with = "as_one_hash")]
    pub outputs: Digest,
    /// As if the row were a command of its own.
    pub exit_code: Option<u8>,
    /// Why it failed.
    pub error: Option<String>,
    /// How long it took.
    pub seconds: f64,
    /// The most device memory that was taken from the driver, as far as its result tells.
    #[serde(rename = "result", deserialize_with = "as_device_bytes")]
    pub device_bytes: Option<u64>,
}

fn as_this_schema<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    match String::deserialize(deserializer)? {
        schema if schema == SCHEMA => Ok(schema),
        other => Err(de::Error::custom(format!("schema `{other}`"))),
    }
}

/// That a line is of this schema.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Schema;

impl<'de> Deserialize<'de> for Schema {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        as_this_schema(deserializer).map(|_| Self)
    }
}

fn as_device_bytes<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u64>, D::Error> {
    deserializer.deserialize_option(DeviceBytes)
}

/// Finds one number in a result, and keeps nothing of the others: results are long, and many.
struct DeviceBytes;

impl<'de> Visitor<'de> for DeviceBytes {
    type Value = Option<u64>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("what a command prints, an object, or nothing")
    }

    fn visit_none<E: de::Error>(self) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_map(self)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let mut bytes = None;
        while let Some(name) = map.next_key::<Cow<'de, str>>()? {
            if name == DEVICE_BYTES { bytes = map.next_value()? } else { _ = map.next_value::<IgnoredAny>()? }
        }
        Ok(bytes)
    }
}

fn as_one_hash<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Digest, D::Error> {
    Contents::deserialize(deserializer).map(|contents| contents.digest())
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
            ended_unix_s: None,
            worker: worker.to_owned(),
            notes: BTreeMap::new(),
            result: Value::Null,
        }
    }

    /// Reads a line of the file at `path`.
    ///
    /// # Errors
    /// [`EngineError::BadData`] for anything else.
    pub fn parse(path: &Path, line: &[u8]) -> Result<Self, EngineError> {
        parse(path, line)
    }

    /// What is kept in mind of it.
    #[must_use]
    pub fn known(&self) -> Known {
        Known {
            schema: Schema,
            id: self.id.clone(),
            attempt: self.attempt,
            state: self.state,
            settings: self.settings,
            input: self.input,
            outputs: self.outputs.digest(),
            exit_code: self.exit_code,
            error: self.error.clone(),
            seconds: self.seconds,
            device_bytes: self.result[DEVICE_BYTES].as_u64(),
        }
    }
}

/// The files of all workers in a folder, by name; none where there is no folder.
pub(super) fn journals(folder: &Path) -> Result<Vec<PathBuf>, EngineError> {
    let io = |source| EngineError::Io { path: folder.to_path_buf(), source };
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(io(source)),
    };
    let mut files: Vec<PathBuf> = Vec::new();
    for entry in entries {
        files.push(entry.map_err(io)?.path());
    }
    files.retain(|path| path.extension().is_some_and(|end| end == "jsonl"));
    files.sort();
    Ok(files)
}

/// One of these files behind its first `read` bytes, and where that is; `None` if nothing was added.
pub(super) fn open_behind(path: &Path, read: u64) -> Result<Option<(File, u64)>, EngineError> {
    let io = |source| EngineError::Io { path: path.to_path_buf(), source };
    let mut file = File::open(path).map_err(io)?;
    let from = match file.metadata().map_err(io)?.len() {
        len if len == read => return Ok(None),
        // Another file by now.
        len if len < read => 0,
        _ => read,
    };
    file.seek(SeekFrom::Start(from)).map_err(io)?;
    Ok(Some((file, from)))
}

/// A record, or what is kept in mind of it, from a line of the file at `path`.
fn parse<'a, T: Deserialize<'a>>(path: &Path, line: &'a [u8]) -> Result<T, EngineError> {
    serde_json::from_slice(line).map_err(|error| bad_data(path, "line", error, SCHEMA))
}

impl State {
    /// In the order in which they hold.
    pub(super) const ALL: [Self; 4] = [Self::Running, Self::Interrupted, Self::Failed, Self::Done];
}

impl Known {
    /// Reads a line of the file at `path`.
    pub(super) fn parse(path: &Path, line: &[u8]) -> Result<Self, EngineError> {
        parse(path, line)
    }

    /// What tells which of two records of a row holds.
    pub(super) fn rank(&self) -> (u32, State) {
        (self.attempt, self.state)
    }
}
