//! What a command leaves behind: an exit code, and its result as a table or as JSON.

use guard4d_engine::EngineError;
use serde::Serialize;

use crate::args::Common;

/// How a command ended without an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// Done; for `verify`: the mark is present.
    Done,
    /// `verify`: absent; `embed`: the quality gate was missed.
    Negative,
    /// `verify`: inconclusive.
    Inconclusive,
}

impl Outcome {
    pub(crate) fn exit_code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Negative => 1,
            Self::Inconclusive => 4,
        }
    }
}

/// Prints `value` as JSON when asked for, else the lines of `human`.
pub(crate) fn print<T: Serialize>(
    common: &Common,
    value: &T,
    human: impl FnOnce(&T) -> String,
) -> Result<(), EngineError> {
    use std::io::Write;
    let text = if common.json {
        serde_json::to_string_pretty(value).expect("report types hold nothing that JSON cannot")
    } else {
        human(value)
    };
    let result = writeln!(std::io::stdout().lock(), "{text}");
    match result {
        // A reader that has seen enough (`| head`) is no failure.
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        Err(source) => Err(EngineError::Io { path: "stdout".into(), source }),
        Ok(()) => Ok(()),
    }
}

/// Two columns, aligned.
pub(crate) fn table(rows: &[(&str, String)]) -> String {
    let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    rows.iter().map(|(name, value)| format!("  {name:width$}  {value}")).collect::<Vec<_>>().join("\n")
}
