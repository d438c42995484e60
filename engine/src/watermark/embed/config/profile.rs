//! Where the numbers come from that nobody sets.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::parse::word;
use crate::error::EngineError;
use crate::evidence::extractor_mode::ExtractorMode;

/// How much work to spend.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Profile {
    /// Fast and coarse, for a first look.
    Draft,
    /// The default.
    Balanced,
    /// The objective of Guard4D as printed (its Eqs. 9 to 11 with the weights of its Sec. 4.1), for comparison; with
    /// `joint` the paper's method. What the paper leaves open is as in the other profiles.
    Faithful,
    /// The single-frame baseline of the paper's Table 1 (GuardSplat): the same objective on frames that have nothing to
    /// do with each other; for `none`, without temporal module and control losses.
    Guardsplat,
    /// The multi-frame baseline of that table: likewise, on clips of one camera.
    MultiFrame,
}

impl Profile {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Draft, Self::Balanced, Self::Faithful, Self::Guardsplat, Self::MultiFrame];

    /// The extractor that a profile is meant for.
    #[must_use]
    pub fn default_mode(self) -> ExtractorMode {
        match self {
            Self::Draft | Self::Balanced => ExtractorMode::Blind,
            Self::Faithful => ExtractorMode::Joint,
            Self::Guardsplat | Self::MultiFrame => ExtractorMode::None,
        }
    }

    /// Whether it takes the paper's objective.
    #[must_use]
    pub fn is_the_papers(self) -> bool {
        matches!(self, Self::Faithful | Self::Guardsplat | Self::MultiFrame)
    }
}

/// The name that files and the command line use.
impl fmt::Display for Profile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl FromStr for Profile {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        word("profile", text)
    }
}
