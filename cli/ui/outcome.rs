//! How a command ended without an error.

use guard4d_engine::detect::trace::Tracing;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::judgement::Verdict;
use guard4d_engine::locate::finding::Locating;

/// Exit code when `embed` did what it was asked to, and the result is not good enough.
const GATE_MISSED: u8 = 1;

/// Exit code when some rows of a farm failed.
const ROWS_FAILED: u8 = 3;

/// Exit code when nobody has checked who made a date.
const DATE_CLAIMED: u8 = 4;

/// Shown below `--help`. [`Outcome::exit_code`], `Verdict::exit_code` and `EngineError::exit_code` give these numbers.
pub(crate) const EXIT_CODES: &str = "Exit codes:
  0   done; verify, demo: the mark is present; trace: a copy was named
  1   verify, demo: absent; trace: no copy; embed: the quality gate was missed (see the receipt)
  2   wrong usage
  3   farm: some rows failed, the others are done
  4   verify, demo, trace, locate: inconclusive; timestamp check: no authority to check the date by
  65  an input's content is wrong          66  an input is missing
  69  no suitable device or program, or    70  internal error
      too little device memory or budget
  73  an output cannot be created          74  reading or writing failed
  75  interrupted, or a ledger is in use;  76  the device was lost
      embed left a checkpoint";

/// How a command ended without an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Done.
    Done,
    /// `embed`: the quality gate was missed.
    GateMissed,
    /// `timestamp check`: the token is whole, and whoever made it was not checked.
    DateClaimed,
    /// `farm`: some rows failed.
    RowsFailed,
    /// `farm run`: it was asked to stop; the next run goes on.
    RowsLeft,
    /// `verify` and `demo`: this is the answer.
    Judged(Verdict),
    /// `trace`: this is the answer.
    Traced(Tracing),
    /// `locate`: this is the answer.
    Located(Locating),
}

impl Outcome {
    pub(crate) fn exit_code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::GateMissed => GATE_MISSED,
            Self::DateClaimed => DATE_CLAIMED,
            Self::RowsFailed => ROWS_FAILED,
            Self::RowsLeft => EngineError::Stopped.exit_code(),
            Self::Judged(verdict) => verdict.exit_code(),
            Self::Traced(tracing) => tracing.exit_code(),
            Self::Located(locating) => locating.exit_code(),
        }
    }
}
