//! What is computed of a row's samples.

use super::stats::Quartiles;
use crate::harness::{Bench, Row, Work};

impl Row {
    pub(crate) fn time(&self) -> Quartiles {
        Quartiles::of(&self.seconds)
    }

    pub(crate) fn core_time(&self) -> Quartiles {
        Quartiles::of(&self.core_seconds)
    }

    /// CPU seconds of the fastest run: what the code takes when nobody else slows the core down.
    pub(crate) fn best_core_seconds(&self) -> f64 {
        self.core_seconds.iter().copied().fold(f64::NAN, f64::min)
    }

    /// The shortest run by the device's clock, or by the one on the wall.
    pub(crate) fn best_seconds(&self) -> f64 {
        self.seconds.iter().copied().fold(f64::NAN, f64::min)
    }

    fn work(&self) -> Option<f64> {
        match self.work {
            Work::Flops(work, _) | Work::Bytes(work, _) => Some(work),
            Work::Mixed => None,
        }
    }

    /// Operations or bytes per second.
    pub(crate) fn rate(&self) -> Option<f64> {
        self.work().map(|work| work / self.time().median)
    }

    /// Operations or bytes per CPU second of the fastest run.
    pub(crate) fn best_core_rate(&self) -> Option<f64> {
        self.work().map(|work| work / self.best_core_seconds())
    }

    /// Operations or bytes per CPU second.
    pub(crate) fn core_rate(&self) -> Option<f64> {
        self.work().map(|work| work / self.core_time().median)
    }
}

/// Best rate of the rows whose names begin with `prefix`, by their clock or by CPU time.
pub(crate) fn peak(bench: &Bench, prefix: &str, rate: impl Fn(&Row) -> Option<f64>) -> Option<f64> {
    bench.rows.iter().filter(|r| r.name.starts_with(prefix)).filter_map(rate).max_by(f64::total_cmp)
}
