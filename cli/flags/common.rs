//! Flags of every command.

use std::sync::Arc;

use clap::{Args, ValueEnum};

use super::device::DeviceFlags;
use crate::shared::session::Session;

/// Flags of every command.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Output")]
pub(crate) struct Common {
    /// Print results as JSON on stdout
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// More talk on stderr; twice for every dispatch
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub(crate) verbose: u8,
    /// No progress bar and no notes on stderr
    #[arg(short, long, global = true)]
    pub(crate) quiet: bool,
    /// The log on stderr as text, or each line as a JSON object for machines that collect logs
    #[arg(long, global = true, value_enum, default_value = "text", env = "GUARD4D_LOG_FORMAT", hide = true)]
    pub(crate) log_format: LogFormat,
    #[command(flatten)]
    pub(crate) device: DeviceFlags,
    /// What this command has in common with others of one process.
    #[arg(skip)]
    pub(crate) session: Option<Arc<Session>>,
}

/// How the log is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LogFormat {
    Text,
    Json,
}
