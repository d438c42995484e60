//! How an extractor was made, which decides what its readings can prove.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::error::EngineError;

/// How the extractor came about, which decides what may be claimed from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ExtractorMode {
    /// Identity before CLIP.
    None,
    /// Trained without the message and without marked clips.
    Blind,
    /// Trained once over random messages and scenes, then frozen.
    Pretrained,
    /// Trained together with the message: it may hold the message itself.
    Joint,
}

impl ExtractorMode {
    /// All, those that give an exact p-value first.
    pub const ALL: [Self; 4] = [Self::None, Self::Blind, Self::Pretrained, Self::Joint];

    /// Whether the extractor is independent of the message, so that p-values are exact.
    #[must_use]
    pub const fn is_message_blind(self) -> bool {
        !matches!(self, Self::Joint)
    }
}

/// The name that files and the command line use.
impl fmt::Display for ExtractorMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl FromStr for ExtractorMode {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        Self::ALL.into_iter().find(|mode| mode.to_string() == text).ok_or_else(|| EngineError::Usage {
            what: "extractor".to_owned(),
            got: text.to_owned(),
            expected: Self::ALL.map(|mode| mode.to_string()).join(", "),
        })
    }
}
