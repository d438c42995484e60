//! How a command ended without an error.

use guard4d_engine::error::EngineError;
use guard4d_engine::evidence::judgement::Verdict;

/// Exit code when `embed` did what it was asked to, and the result is not good enough.
const GATE_MISSED: u8 = 1;

/// Exit code when some rows of a farm failed.
const ROWS_FAILED: u8 = 3;

/// Exit code when nobody has checked who made a date.
const DATE_CLAIMED: u8 = 4;

/// Shown below `--help`. [`Outcome::exit_code`], `Verdict::exit_code` and `EngineError::exit_code` give these numbers.
pub(crate) const EXIT_CODES: &str = "Exit codes:
  0   done; verify, demo: the mark is present
  1   verify, demo: absent; embed: the quality gate was missed (the receipt has the numbers)
  2   wrong usage
  3   farm: some rows failed, the others are done
  4   verify, demo: inconclusive; timestamp check: no authority was given to check the date by
  65  an input's content is wrong          66  an input is missing
  69  no suitable device or program, or    70  internal error
      too little device memory or budget
  73  an output cannot be created          74  reading or writing failed
  75  interrupted; embed left a checkpoint 76  the device was lost";

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
        }
    }
}
