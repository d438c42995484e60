//! Why a task ends early, and with which exit code.

use std::io;
use std::path::Path;

/// What a task returns.
pub(crate) type Result<T> = std::result::Result<T, Error>;

/// Why a task ends early.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Error {
    /// This machine lacks something; the text says what.
    #[error("{0}")]
    Missing(String),
    /// A program failed, and has said why itself.
    #[error("a program ended with exit code {0}")]
    Failed(u8),
    /// Both ways to make something, whose names the text holds, gave something else.
    #[error("{0}")]
    Differs(String),
    /// A promise that is not kept; the text says which.
    #[error("{0}")]
    Broken(String),
    /// A file or a program could not be used.
    #[error("{what}: {source}")]
    Io {
        /// The file or the program.
        what: String,
        /// What the system says.
        source: io::Error,
    },
}

impl Error {
    /// The exit code: 69 where something is missing, a failed program's own, else 1.
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::Missing(_) => 69,
            Self::Failed(code) => *code,
            Self::Differs(_) | Self::Broken(_) | Self::Io { .. } => 1,
        }
    }

    /// Whether somebody else has already said what went wrong.
    pub(crate) fn is_told(&self) -> bool {
        matches!(self, Self::Failed(_))
    }
}

/// Names the file or program that the system speaks of.
pub(crate) trait Naming<T> {
    /// The same with the name of a program.
    fn of_program(self, name: &str) -> Result<T>;
    /// The same with the path of a file.
    fn of_file(self, path: &Path) -> Result<T>;
}

impl<T> Naming<T> for io::Result<T> {
    fn of_program(self, name: &str) -> Result<T> {
        self.map_err(|source| match source.kind() {
            io::ErrorKind::NotFound => Error::Missing(format!("the program {name} is missing")),
            _ => Error::Io { what: name.to_owned(), source },
        })
    }

    fn of_file(self, path: &Path) -> Result<T> {
        self.map_err(|source| Error::Io { what: path.display().to_string(), source })
    }
}
