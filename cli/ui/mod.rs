//! What whoever runs the program sees and sends: exit codes, results, notes, progress and signals.

pub(crate) mod config_markdown;
pub(crate) mod dates;
pub(crate) mod document;
pub(crate) mod log;
pub(crate) mod markdown;
pub(crate) mod outcome;
pub(crate) mod progress;
pub(crate) mod report;
pub(crate) mod stop;
pub(crate) mod tracing_report;
pub(crate) mod verification;
