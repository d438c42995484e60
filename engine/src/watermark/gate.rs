//! Whether an embedding is as good as its owner asked for.

use std::fmt;

use serde::Serialize;

use super::delivery::thresholds;
use super::evaluate::Evaluation;
use super::statistics::required_matches;
use crate::error::EngineError;

/// A mean of fractions may lie this much below its true value.
const ROUNDING: f64 = 1e-9;

/// Least quality on held-out 8-bit frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// Least share of bits right on marked clips.
    pub min_accuracy: f64,
    /// Least whole-frame PSNR, mean over views, in dB; none asks for nothing.
    pub min_psnr_db: Option<f64>,
}

/// A figure that a gate looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Figure {
    /// Share of bits right on marked clips.
    BitAccuracy,
    /// Whole-frame PSNR, mean over views, in dB.
    Psnr,
}

/// A figure that fell short.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shortfall {
    /// Which.
    pub field: Figure,
    /// What was measured.
    pub got: f64,
    /// The least that was asked for.
    pub expected: f64,
}

impl Gate {
    /// The gate that asks for what `verify` needs: so many bits right that the decision rule of this message length
    /// says "present". Messages too short to reach its rate are asked for all their bits.
    #[must_use]
    pub fn for_bits(bits: usize) -> Self {
        Self::after_search(bits, 1)
    }

    /// The same for a message that `verify` will choose from `searched`, as it does for ids.
    #[must_use]
    pub fn after_search(bits: usize, searched: u32) -> Self {
        let length = u32::try_from(bits).unwrap_or(u32::MAX);
        let needed = required_matches(length, thresholds(bits).fpr / f64::from(searched)).unwrap_or(length);
        Self { min_accuracy: f64::from(needed) / f64::from(length.max(1)), min_psnr_db: None }
    }

    /// Refuses bounds that no result can be compared with.
    ///
    /// # Errors
    /// [`EngineError::Usage`] naming the bound.
    pub fn validate(&self) -> Result<(), EngineError> {
        let usage = |what: &str, got: f64, expected: &str| {
            Err(EngineError::Usage { what: what.to_owned(), got: got.to_string(), expected: expected.to_owned() })
        };
        if !(0.0..=1.0).contains(&self.min_accuracy) {
            return usage("least bit accuracy", self.min_accuracy, "a share from 0 to 1");
        }
        match self.min_psnr_db {
            Some(db) if !db.is_finite() => usage("least PSNR", db, "a number of dB"),
            _ => Ok(()),
        }
    }

    /// The figures that fall short; none when the gate is met. A figure that is no number falls short.
    #[must_use]
    pub fn missed(&self, evaluation: &Evaluation) -> Vec<Shortfall> {
        let accuracy = (Figure::BitAccuracy, evaluation.marked, Some(self.min_accuracy));
        let psnr = (Figure::Psnr, evaluation.psnr.mean_of_views_db.0, self.min_psnr_db);
        let short = |(field, got, bound): (Figure, f64, Option<f64>)| {
            let expected = bound?;
            let is_met = got + ROUNDING >= expected;
            (!is_met).then_some(Shortfall { field, got, expected })
        };
        [accuracy, psnr].into_iter().filter_map(short).collect()
    }
}

impl fmt::Display for Shortfall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { field, got, expected } = *self;
        match field {
            Figure::BitAccuracy => {
                write!(
                    f,
                    "bits right on marked clips: {:.1} %, expected at least {:.1} %",
                    100.0 * got,
                    100.0 * expected
                )
            }
            Figure::Psnr => write!(f, "PSNR of whole frames: {got:.2} dB, expected at least {expected:.2} dB"),
        }
    }
}
