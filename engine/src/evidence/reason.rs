//! Why a verdict is what it is.

use std::fmt;

use serde::Serialize;

/// Why a verdict is what it is.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[expect(missing_docs, reason = "Display says what each field is")]
pub enum Reason {
    Passes { p_value: f64, fpr: f64 },
    AtChance { p_value: f64, absent_above: f64 },
    Weak { p_value: f64, fpr: f64 },
    TooFewFrames { got: u32, needed: u32 },
    FramesTooSmall { got_px: u32, needed_px: u32 },
    CannotReach { best_p_value: f64, fpr: f64 },
    ControlFires { control: String, name: String },
    EmpiricalOnly { num_clips: u32 },
    NotCommitted { schema: String },
    UnknownClip { clip: String },
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Passes { p_value, fpr } => {
                write!(f, "p = {p_value:.2e} reaches the threshold {fpr:.0e}")
            }
            Self::AtChance { p_value, absent_above } => {
                write!(f, "p = {p_value:.2} is what chance gives (above {absent_above})")
            }
            Self::Weak { p_value, fpr } => {
                write!(f, "p = {p_value:.2e} misses the threshold {fpr:.0e}; more frames or views may decide")
            }
            Self::TooFewFrames { got, needed } => write!(f, "{got} of at least {needed} frames"),
            Self::FramesTooSmall { got_px, needed_px } => {
                write!(f, "frames of {got_px} px, {needed_px} px needed")
            }
            Self::CannotReach { best_p_value, fpr } => {
                write!(f, "at best p = {best_p_value:.1e} is possible here, the threshold is {fpr:.0e}")
            }
            Self::ControlFires { control, name } => {
                write!(f, "the control \"{control}\" ({name}) is not at chance")
            }
            Self::NotCommitted { schema } => {
                write!(f, "a receipt of {schema} leaves parts of the key file free, which decide what is read")
            }
            Self::UnknownClip { clip } => {
                write!(f, "the CLIP checkpoint {clip} is not the program's own: whoever made it could have made it ")?;
                f.write_str("read the message; --trust-clip names it if somebody else published it")
            }
            Self::EmpiricalOnly { num_clips } => {
                f.write_str("the extractor was trained with the message, and can say it by itself: ")?;
                write!(f, "no p-value, only a bound from {num_clips} films without a mark, which is not enough")
            }
        }
    }
}
