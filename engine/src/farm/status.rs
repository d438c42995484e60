//! How far a manifest is, from its ledger and the records since.

use std::collections::BTreeMap;

use serde::Serialize;

use super::forecast::Pace;
use super::journal::Journal;
use super::manifest::Manifest;
use super::record::{Known, State};
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
    /// What the others will take one after the other, by what the done ones of their job and cost took; `None` as long
    /// as some job has none.
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
        for (row, record) in manifest.rows().iter().zip(journal.of_rows(manifest.rows())) {
            paces.entry(&row.job).or_default().count(row, record);
            match record.map(|record| (record.state, record)) {
                Some((State::Done, record)) => {
                    status.done += 1;
                    done.push(record);
                }
                Some((State::Failed, record)) => {
                    status.failed += 1;
                    let failure = Failure { id: row.id.clone(), error: record.error.clone().unwrap_or_default() };
                    status.failures.entry(record.exit_code.unwrap_or_default()).or_default().push(failure);
                }
                Some((State::Running, _)) => status.running += 1,
                Some((State::Interrupted, _)) => status.interrupted += 1,
                None => status.pending += 1,
            }
        }
        status.seconds = paces.values().map(Pace::seconds).sum();
        status.seconds_left = paces.values().map(Pace::seconds_left).sum();
        done.sort_by(|a, b| b.seconds.total_cmp(&a.seconds));
        let slow = |record: &&Known| Slow { id: record.id.clone(), seconds: record.seconds };
        status.slowest = done.iter().take(SLOWEST).map(slow).collect();
        Ok(status)
    }
}
