//! How far a manifest is, from its records alone.

use std::collections::BTreeMap;

use rayon::prelude::*;
use serde::Serialize;

use super::journal::Journal;
use super::manifest::{Manifest, Row};
use super::record::{Known, State};
use crate::base::digest::Digest;
use crate::error::EngineError;

/// Most rows that are named as the slowest.
const SLOWEST: usize = 5;

/// How far a manifest is. Files are not read again: `run` does that.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Status {
    /// Rows of the manifest.
    pub rows: usize,
    /// Done, with the settings that the manifest now has.
    pub done: usize,
    /// Begun and not ended. A worker that was killed leaves such rows, too; the next run goes on with them.
    pub running: usize,
    /// Asked to stop; the next run goes on with them.
    pub interrupted: usize,
    /// Failed.
    pub failed: usize,
    /// Not begun, or of other settings by now.
    pub pending: usize,
    /// What the done rows took together, seconds.
    pub seconds: f64,
    /// What the others will take one after the other, by what the done ones of their job took; `None` as long as some
    /// job has none.
    pub seconds_left: Option<f64>,
    /// The done rows that took longest, slowest first.
    pub slowest: Vec<Slow>,
    /// Failed rows by exit code.
    pub failures: BTreeMap<u8, Vec<Failure>>,
}

/// A row and what it took.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Slow {
    /// The row's.
    pub id: String,
    /// Seconds.
    pub seconds: f64,
}

/// A row and why it failed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Failure {
    /// The row's.
    pub id: String,
    /// Why.
    pub error: String,
}

/// What the rows of a job took, and how many of them are left.
#[derive(Default)]
struct Pace {
    seconds: f64,
    done: usize,
    left: usize,
}

impl Status {
    /// Reads the records.
    ///
    /// # Errors
    /// Those of [`Journal::open`].
    pub fn of(manifest: &Manifest) -> Result<Self, EngineError> {
        let journal = Journal::open(&manifest.state(), "")?;
        let mut status = Self { rows: manifest.rows().len(), ..Self::default() };
        let mut paces: BTreeMap<&str, Pace> = BTreeMap::new();
        let mut done: Vec<&Known> = Vec::new();
        let settings: Vec<Digest> = manifest.rows().par_iter().map(Row::settings_hash).collect();
        for (row, settings) in manifest.rows().iter().zip(settings) {
            let record = journal.last(&row.id).filter(|record| record.settings == settings);
            let pace = paces.entry(&row.job).or_default();
            match record.map(|record| (record.state, record)) {
                Some((State::Done, record)) => {
                    status.done += 1;
                    pace.done += 1;
                    pace.seconds += record.seconds;
                    done.push(record);
                    continue;
                }
                Some((State::Failed, record)) => {
                    status.failed += 1;
                    let failure = Failure { id: row.id.clone(), error: record.error.clone().unwrap_or_default() };
                    status.failures.entry(record.exit_code.unwrap_or_default()).or_default().push(failure);
                    continue;
                }
                Some((State::Running, _)) => status.running += 1,
                Some((State::Interrupted, _)) => status.interrupted += 1,
                None => status.pending += 1,
            }
            pace.left += 1;
        }
        status.seconds = paces.values().map(|pace| pace.seconds).sum();
        let left = |Pace { seconds, done, left }: &Pace| match (*left, *done) {
            (0, _) => Some(0.0),
            (_, 0) => None,
            (left, done) => Some(seconds / done as f64 * left as f64),
        };
        status.seconds_left = paces.values().map(left).sum();
        done.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        let slow = |record: &&Known| Slow { id: record.id.clone(), seconds: record.seconds };
        status.slowest = done.iter().take(SLOWEST).map(slow).collect();
        Ok(status)
    }
}
