//! What the rows that are left will take, by what the done rows of their job took.

use std::collections::BTreeMap;

use serde::Serialize;
use walkdir::WalkDir;

use super::manifest::{Manifest, Row};
use super::record::{Known, State};

/// Rows of a job whose outputs are measured, at most.
const MEASURED: usize = 64;

/// Time, device memory and disk of a job's rows.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Forecast {
    /// Rows that are done.
    pub done: usize,
    /// Rows that are not.
    pub left: usize,
    /// Those that are left, one after the other, in seconds; `None` where nothing is known of any.
    pub seconds: Option<f64>,
    /// The most device memory that a row had taken from the driver, bytes; `None` where no row has told.
    pub device_bytes: Option<u64>,
    /// What those that are left will add to the disk, bytes; `None` where nothing is known of any.
    pub disk_bytes: Option<u64>,
    /// The row that was tried for this, where none is done.
    pub tried: Option<String>,
}

/// What one row took that was tried.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Trial {
    /// Seconds.
    pub seconds: f64,
    /// Device memory at its peak, bytes.
    pub device_bytes: u64,
    /// What an output holds beside a copy of its input, bytes.
    pub added_bytes: u64,
}

/// What is known of a job.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Pace {
    seconds: f64,
    done: usize,
    done_cost: f64,
    left: usize,
    left_cost: f64,
    device_bytes: Option<u64>,
}

impl Pace {
    /// Counts a row and its record, if that holds for the row's present settings.
    pub(super) fn count(&mut self, row: &Row, record: Option<&Known>) {
        match record {
            record if is_left(record) => {
                self.left += 1;
                self.left_cost += row.cost;
            }
            Some(Known { state: State::Done, seconds, device_bytes, .. }) => {
                self.done += 1;
                self.done_cost += row.cost;
                self.seconds += seconds;
                self.device_bytes = self.device_bytes.max(*device_bytes);
            }
            _ => {}
        }
    }

    /// How many done rows the rows that are left are worth.
    fn worth(&self) -> Option<f64> {
        match self {
            Self { left: 0, .. } => Some(0.0),
            Self { done: 0, .. } => None,
            Self { done_cost, .. } if *done_cost <= 0.0 => Some(self.left as f64),
            Self { done, done_cost, left_cost, .. } => Some(left_cost / done_cost * *done as f64),
        }
    }

    /// Seconds that the done rows took.
    pub(super) fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Seconds that those that are left will take one after the other.
    pub(super) fn seconds_left(&self) -> Option<f64> {
        self.worth().map(|worth| if worth == 0.0 { 0.0 } else { self.seconds / self.done as f64 * worth })
    }
}

impl Forecast {
    /// By job, from the last records of rows in the order of the manifest: those that hold for present settings.
    /// Outputs of some done rows are measured on the disk.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, reason = "an estimate in whole bytes")]
    pub fn of(manifest: &Manifest, records: &[Option<&Known>]) -> BTreeMap<String, Self> {
        let mut paces: BTreeMap<&str, (Pace, Vec<&Row>)> = BTreeMap::new();
        for (row, record) in manifest.rows().iter().zip(records) {
            let (pace, done) = paces.entry(&row.job).or_default();
            pace.count(row, *record);
            if record.is_some_and(|record| record.state == State::Done) {
                done.push(row);
            }
        }
        let forecast = |(job, (pace, done)): (&str, (Pace, Vec<&Row>))| {
            let step = done.len().div_ceil(MEASURED).max(1);
            let measured: Vec<u64> = done.iter().step_by(step).map(|row| bytes_of(manifest, &row.output)).collect();
            let mean = measured.iter().sum::<u64>() as f64 / measured.len().max(1) as f64;
            let forecast = Self {
                done: pace.done,
                left: pace.left,
                seconds: pace.seconds_left(),
                device_bytes: pace.device_bytes,
                disk_bytes: pace.worth().map(|worth| (mean * worth) as u64),
                tried: None,
            };
            (job.to_owned(), forecast)
        };
        paces.into_iter().map(forecast).collect()
    }

    /// Takes what a row took that was tried for all that are left, each by its cost.
    pub fn take(&mut self, manifest: &Manifest, row: &Row, trial: Trial, left: &[&Row]) {
        let pace = Pace {
            seconds: trial.seconds,
            done: 1,
            done_cost: row.cost,
            left: left.len(),
            left_cost: left.iter().map(|row| row.cost).sum(),
            device_bytes: Some(trial.device_bytes),
        };
        let copies: u64 = left.iter().map(|row| bytes_of(manifest, &row.input)).sum();
        self.seconds = pace.seconds_left();
        self.device_bytes = pace.device_bytes;
        self.disk_bytes = Some(copies + trial.added_bytes * left.len() as u64);
        self.tried = Some(row.id.clone());
    }
}

/// Rows of a job that are still to be done, of those of [`Forecast::of`].
#[must_use]
pub fn left_of<'m>(job: &str, manifest: &'m Manifest, records: &[Option<&Known>]) -> Vec<&'m Row> {
    let rows = manifest.rows().iter().zip(records);
    rows.filter(|(row, record)| row.job == job && is_left(**record)).map(|(row, _)| row).collect()
}

fn is_left(record: Option<&Known>) -> bool {
    record.is_none_or(|record| !record.state.is_over())
}

/// What a path of the manifest holds on the disk; nothing where it is not there.
#[must_use]
pub fn bytes_of(manifest: &Manifest, path: &str) -> u64 {
    let entries = WalkDir::new(manifest.folder().join(path)).into_iter().filter_map(Result::ok);
    entries.filter_map(|entry| entry.metadata().ok()).filter(std::fs::Metadata::is_file).map(|data| data.len()).sum()
}
