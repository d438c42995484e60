//! The owner's chips in films whose cameras are known: what they say beside the message.

use serde::Serialize;

use super::gathered::{Gathered, SharedClaim};
use crate::error::EngineError;
use crate::evidence::thresholds::Thresholds;
use crate::fingerprint::issue::Issue;

/// What the chips say.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ChipsReading {
    /// How well they agree with the key's.
    #[serde(flatten)]
    pub claim: SharedClaim,
    /// Frames that were compared with the original.
    pub frames: u64,
    /// What p-values are multiplied by: the claims that this one was chosen from, and the readings.
    pub searched: u32,
    /// Whether they alone prove it by the receipt's rule.
    pub proves: bool,
}

impl ChipsReading {
    /// Of what films say of an issue's chips, one of so many readings, by a receipt's rule.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for chips of another issue.
    pub(super) fn of(
        gathered: &Gathered,
        issue: &Issue<'_>,
        searched: u32,
        rule: &Thresholds,
    ) -> Result<Self, EngineError> {
        let reading = Self { claim: gathered.shared(issue)?, frames: gathered.frames, searched, proves: false };
        let proves = reading.log10_p_searched() + f64::from(rule.num_claims).log10() <= rule.fpr.log10();
        Ok(Self { proves, ..reading })
    }

    /// Decimal logarithm of the bound on the p-value, times what it was chosen from.
    #[must_use]
    pub fn log10_p_searched(&self) -> f64 {
        self.claim.log10_p + f64::from(self.searched).log10()
    }
}
