//! Controls: readings of what surely carries no mark of the owner.

use std::fmt;

use serde::Serialize;

use super::message::Message;
use super::reading::Reading;
use super::statistics::chance_band;
use crate::error::EngineError;

/// What a control is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlKind {
    /// The owner's asset before embedding, rendered like the suspect clip.
    CleanRender,
    /// A clip that has nothing to do with the asset.
    UnrelatedClip,
    /// Such a clip that the program brings along.
    OwnClip,
    /// The suspect clip read with another trained key, for that key's message.
    OtherKey,
    /// The suspect clip against the inverted message.
    InvertedMessage,
    /// The suspect clip against the messages of other keys, derived from the owner's.
    OtherMessages,
    /// The suspect clip's features read by those keys' own calibrations, each for its own message.
    OtherReadings,
}

impl ControlKind {
    /// Controls that need input from the caller; the others are always run.
    pub const SUPPLIED: [Self; 3] = [Self::CleanRender, Self::UnrelatedClip, Self::OtherKey];

    /// Whether it is a film without a mark that the owner's own reader has read.
    #[must_use]
    pub const fn is_unmarked_film(self) -> bool {
        matches!(self, Self::CleanRender | Self::UnrelatedClip | Self::OwnClip)
    }
}

impl fmt::Display for ControlKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::CleanRender => "clean render",
            Self::UnrelatedClip => "unrelated clip",
            Self::OwnClip => "the program's own clip",
            Self::OtherKey => "other key",
            Self::InvertedMessage => "inverted message",
            Self::OtherMessages => "other keys' messages",
            Self::OtherReadings => "other keys' readings",
        })
    }
}

/// A reading of something that should not hold the message.
#[derive(Clone, Debug)]
pub struct Control {
    /// What was read.
    pub kind: ControlKind,
    /// File or key, for the report.
    pub name: String,
    /// The extractor's answer.
    pub reading: Reading,
    /// The message it is compared with.
    pub message: Message,
}

impl Control {
    /// How far it is from the band that chance keeps to with probability `confidence`.
    pub(super) fn chance_deviation(&self, confidence: f64) -> Result<ChanceDeviation, EngineError> {
        ChanceDeviation::measure(self.reading.matches(&self.message)?, self.message.num_bits(), confidence)
    }
}

/// Whether a control found what it must not find.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlState {
    /// Consistent with chance.
    Quiet,
    /// Outside the two-sided chance band.
    Fires,
}

/// How far one reading is from chance, on either side. Accuracy far *below* one half is as informative as above.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChanceDeviation {
    /// Matching bits.
    pub matches: u32,
    /// Bits compared.
    pub num_bits: u32,
    /// |accuracy − ½|.
    pub deviation: f64,
    /// Fewest matches inside the chance band.
    pub band_low: u32,
    /// Most matches inside the chance band.
    pub band_high: u32,
    /// Inside or outside.
    pub state: ControlState,
}

impl ChanceDeviation {
    /// Share of the bits that match.
    #[must_use]
    pub fn share(&self) -> f64 {
        f64::from(self.matches) / f64::from(self.num_bits)
    }

    /// Compares a match count with the band that chance keeps to with probability `confidence`.
    ///
    /// # Errors
    /// [`EngineError::Usage`] unless `confidence` is in [0, 1).
    pub fn measure(matches: u32, num_bits: u32, confidence: f64) -> Result<Self, EngineError> {
        let band = chance_band(num_bits, confidence)?;
        let state = if band.contains(&matches) { ControlState::Quiet } else { ControlState::Fires };
        Ok(Self {
            matches,
            num_bits,
            deviation: (f64::from(matches) / f64::from(num_bits) - 0.5).abs(),
            band_low: *band.start(),
            band_high: *band.end(),
            state,
        })
    }
}

/// Outcome of one control.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ControlResult {
    /// What was read.
    pub kind: ControlKind,
    /// File or key.
    pub name: String,
    /// How far from chance it is.
    pub chance_deviation: ChanceDeviation,
}
