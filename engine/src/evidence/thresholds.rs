//! The rule of decision: what a reading must show.

use serde::{Deserialize, Serialize};

use crate::error::EngineError;

/// False-positive rate asked for by messages too short for the default one.
const SHORT_MESSAGE_FPR: f64 = 1e-3;

/// Bits from which the default rate can be reached (method: 32 bits reach 1e-6).
const LONG_MESSAGE_BITS: usize = 32;

/// Which of the two exact tests decides. Chosen beforehand and committed to: the smaller of two
/// p-values is not a p-value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DecisionStatistic {
    /// Number of matching bits.
    Matches,
    /// Sum of logits signed by the message; stronger when bits differ in reliability.
    #[default]
    SoftScore,
}

/// Decision rule; part of a receipt's commitment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Thresholds {
    /// False-positive rate at which "present" is said.
    pub fpr: f64,
    /// Test that decides.
    pub statistic: DecisionStatistic,
    /// Number of keys or owners tried on the clip; the p-value is multiplied by it (Bonferroni).
    pub num_claims: u32,
    /// Fewest frames for any answer but "inconclusive".
    pub min_frames: u32,
    /// Smallest frame side for any answer but "inconclusive".
    pub min_side_px: u32,
    /// p-value above which "absent" is said; between the two rates the clip is inconclusive.
    pub absent_above: f64,
    /// Probability that chance alone makes any control fire.
    pub control_level: f64,
}

impl Default for Thresholds {
    fn default() -> Self {
        Self {
            fpr: 1e-6,
            statistic: DecisionStatistic::default(),
            num_claims: 1,
            min_frames: 8,
            min_side_px: 64,
            absent_above: 0.05,
            control_level: 0.01,
        }
    }
}

impl Thresholds {
    /// The rule that goes with a message length.
    #[must_use]
    pub fn for_bits(bits: usize) -> Self {
        let default = Self::default();
        if bits >= LONG_MESSAGE_BITS { default } else { Self { fpr: SHORT_MESSAGE_FPR, ..default } }
    }

    /// Whether this rule says "present" no more easily than `other` does. A rate that is no number is easier than any.
    ///
    /// Both tests are exact, so that either may decide. `control_level` is how often controls fire by chance: controls
    /// that fire less often forbid less.
    #[must_use]
    pub fn is_as_strict_as(&self, other: &Self) -> bool {
        self.fpr <= other.fpr
            && self.num_claims >= other.num_claims
            && self.min_frames >= other.min_frames
            && self.min_side_px >= other.min_side_px
            && self.control_level >= other.control_level
    }

    /// Checks that the rule is one: rates in (0, 1), `fpr` ≤ `absent_above`, at least one claim and frame.
    ///
    /// # Errors
    /// [`EngineError::Usage`] naming the field.
    pub fn validate(&self) -> Result<(), EngineError> {
        let rate = |r: f64| r > 0.0 && r < 1.0;
        let usage = |what: &str, got: String, expected: &str| {
            Err(EngineError::Usage { what: format!("threshold `{what}`"), got, expected: expected.to_owned() })
        };
        if !rate(self.fpr) {
            return usage("fpr", self.fpr.to_string(), "between 0 and 1");
        }
        if !(rate(self.absent_above) && self.fpr <= self.absent_above) {
            let got = self.absent_above.to_string();
            return usage("absent_above", got, "at least fpr and below 1");
        }
        if !rate(self.control_level) {
            let got = self.control_level.to_string();
            return usage("control_level", got, "between 0 and 1");
        }
        if self.num_claims == 0 {
            return usage("num_claims", "0".to_owned(), "at least 1");
        }
        if self.min_frames == 0 {
            return usage("min_frames", "0".to_owned(), "at least 1");
        }
        Ok(())
    }
}
