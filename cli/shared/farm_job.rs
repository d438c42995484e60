//! How a command does the rows of a farm.

use std::path::Path;

use guard4d_engine::base::checkpoint;
use guard4d_engine::error::EngineError;
use guard4d_engine::farm::forecast::Trial;
use guard4d_engine::farm::manifest::Row;
use guard4d_engine::farm::runner::Attempt;
use serde_json::Value;

/// A command that rows can name. Each has one beside its `run`.
pub(crate) struct FarmJob {
    /// Its name on the command line, and in the column `job`.
    pub(crate) command: &'static str,
    /// Whether it reads something.
    pub(crate) has_input: bool,
    /// Whether it may open a device.
    pub(crate) needs_device: bool,
    /// Input and output of a row as the command takes them, with what the attempt says of earlier ones. Flags of the
    /// row's other columns come before them.
    pub(crate) arguments: fn(&Row, Attempt) -> Vec<String>,
    /// Flags that the farm gives, which are therefore no columns.
    pub(crate) reserved: &'static [&'static str],
    /// Writes what the command prints as the output, where that is what it makes; what of it goes into the records.
    pub(crate) keep: fn(&Path, Value) -> Result<Value, EngineError>,
    /// What a row of it would take, from what the command prints with `--dry-run`; none for a command without.
    pub(crate) trial: Option<fn(&Value) -> Trial>,
}

/// What the command prints is for the records alone.
pub(crate) fn keep_in_records(_: &Path, printed: Value) -> Result<Value, EngineError> {
    Ok(printed)
}

/// `--overwrite`, where an earlier attempt left something.
pub(crate) fn overwrite(attempt: Attempt) -> Option<String> {
    attempt.replaces.then(|| "--overwrite".to_owned())
}

/// `--out=OUTPUT` and the input behind `--`, as most commands take them.
pub(crate) fn out_and_input(row: &Row, attempt: Attempt) -> Vec<String> {
    let out = [format!("--out={}", row.output)];
    let input = (!row.input.is_empty()).then(|| ["--".to_owned(), row.input.clone()]);
    overwrite(attempt).into_iter().chain(out).chain(input.into_iter().flatten()).collect()
}

/// The same, with `--resume` where an earlier attempt of the same row with the same settings left a checkpoint.
pub(crate) fn resumed(row: &Row, attempt: Attempt) -> Vec<String> {
    let goes_on = attempt.goes_on && checkpoint::path_beside(Path::new(&row.output)).exists();
    let resume = goes_on.then(|| "--resume".to_owned());
    resume.into_iter().chain(out_and_input(row, attempt)).collect()
}
