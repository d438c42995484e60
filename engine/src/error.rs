//! Errors of the engine, each with the exit code that the command line returns for it.

use std::path::PathBuf;

use guard4d_kernels::KernelError;
use miette::Diagnostic;
use thiserror::Error;

/// Exit code of an error inside guard4d, a panic included.
pub const INTERNAL_ERROR: u8 = 70;

/// Everything that can go wrong in the engine; messages name file, field, expected and found.
#[derive(Debug, Error, Diagnostic)]
pub enum EngineError {
    /// The device layer failed.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Kernel(#[from] KernelError),
    /// A request that cannot be carried out as asked, such as a message longer than the key's bits.
    #[error("{what}: {got}, expected {expected}")]
    #[diagnostic(code(guard4d::usage))]
    Usage {
        /// The option or argument.
        what: String,
        /// What was given.
        got: String,
        /// What is accepted.
        expected: String,
    },
    /// An input file's content is not what its format promises.
    #[error("{}: {field}: {got}, expected {expected}", path.display())]
    #[diagnostic(code(guard4d::bad_data))]
    BadData {
        /// File that was read.
        path: PathBuf,
        /// Field, tensor or section inside it.
        field: String,
        /// What was found.
        got: String,
        /// What the format or the tool needs.
        expected: String,
    },
    /// An input does not exist.
    #[error("{}: not found ({expected})", path.display())]
    #[diagnostic(code(guard4d::missing_input))]
    MissingInput {
        /// Path that was asked for.
        path: PathBuf,
        /// What should have been there.
        expected: String,
    },
    /// An output cannot be created: it exists, or the place cannot be written.
    #[error("{}: cannot create: {reason}", path.display())]
    #[diagnostic(code(guard4d::cannot_create))]
    CannotCreate {
        /// Output path.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// Reading or writing failed half-way.
    #[error("{}: {source}", path.display())]
    #[diagnostic(code(guard4d::io))]
    Io {
        /// File concerned.
        path: PathBuf,
        /// The system's own words.
        source: std::io::Error,
    },
    /// An external program is missing or failed.
    #[error("{program}: {reason}")]
    #[diagnostic(code(guard4d::program))]
    Program {
        /// Program name.
        program: String,
        /// What happened, with the end of its own messages.
        reason: String,
    },
    /// A number that must be finite is not; nothing may be concluded from it.
    #[error("{what}: {got}, expected finite numbers")]
    #[diagnostic(code(guard4d::not_finite))]
    NotFinite {
        /// What was computed or given, with the place inside it.
        what: String,
        /// The offending value.
        got: f64,
    },
    /// Another process holds what is needed, and did not let go of it in time.
    #[error("{}: another process is using it", path.display())]
    #[diagnostic(code(guard4d::busy), help("run the same command again when that process is done"))]
    Busy {
        /// File that is held.
        path: PathBuf,
    },
    /// The run was interrupted; a valid checkpoint was written.
    #[error("interrupted; checkpoint at {}", checkpoint.display())]
    #[diagnostic(code(guard4d::interrupted), help("run the same command with --resume to go on"))]
    Interrupted {
        /// Where the state was saved.
        checkpoint: PathBuf,
    },
    /// The run was interrupted before there was anything to keep.
    #[error("interrupted; nothing was written")]
    #[diagnostic(code(guard4d::stopped), help("run the same command again"))]
    Stopped,
}

impl EngineError {
    /// Process exit code (sysexits where one fits; see docs/reference/exit-codes.md).
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Usage { .. } => 2,
            Self::BadData { .. } => 65,
            Self::MissingInput { .. } => 66,
            Self::Kernel(
                KernelError::NoDriver { .. }
                | KernelError::NoDevice { .. }
                | KernelError::Unsuitable { .. }
                | KernelError::Allocation { .. }
                | KernelError::OverBudget { .. },
            )
            | Self::Program { .. } => 69,
            Self::Kernel(KernelError::DeviceLost { .. }) => 76,
            Self::Kernel(_) | Self::NotFinite { .. } => INTERNAL_ERROR,
            Self::CannotCreate { .. } => 73,
            Self::Io { .. } => 74,
            Self::Busy { .. } | Self::Interrupted { .. } | Self::Stopped => 75,
        }
    }
}
