//! What the files for all schedulers share: a manifest, its tasks, and how their command is written.

use std::path::Path;

use crate::error::EngineError;

/// A manifest, and how its rows are dealt.
#[derive(Clone, Copy, Debug)]
pub struct Submission<'a> {
    /// This program, as nodes find it.
    pub program: &'a Path,
    /// The manifest, as nodes find it.
    pub manifest: &'a Path,
    /// Where logs go, as nodes find it.
    pub logs: &'a Path,
    /// Rows of the manifest, at least one.
    pub rows: usize,
    /// Tasks, at least one.
    pub shards: usize,
}

impl Submission<'_> {
    /// The command of a task, as a shell takes it; `rows` says which.
    pub(super) fn command(&self, rows: &str) -> Result<String, EngineError> {
        Ok(format!("{} farm run {} {rows}", quoted(self.program)?, quoted(self.manifest)?))
    }

    /// Refuses more tasks than a scheduler takes; `why` says what `most` is.
    pub(super) fn at_most(&self, most: usize, why: &str) -> Result<(), EngineError> {
        if self.shards <= most {
            return Ok(());
        }
        Err(EngineError::Usage {
            what: "--shards".to_owned(),
            got: self.shards.to_string(),
            expected: format!("at most {most}, {why}"),
        })
    }
}

/// A path as a shell takes it.
pub(super) fn quoted(path: &Path) -> Result<String, EngineError> {
    let wrong = || unnamed(path, "UTF-8 without NUL");
    let text = path.to_str().ok_or_else(wrong)?;
    Ok(shlex::try_quote(text).map_err(|_| wrong())?.into_owned())
}

/// A path for a file that ends a value with its line, or cannot hold control characters at all.
pub(super) fn printable(path: &Path) -> Result<&str, EngineError> {
    let text = path.to_str().filter(|text| !text.chars().any(char::is_control));
    text.ok_or_else(|| unnamed(path, "UTF-8 without control characters"))
}

/// Why a path cannot be named.
pub(super) fn unnamed(path: &Path, expected: &str) -> EngineError {
    EngineError::Usage { what: "path".to_owned(), got: path.display().to_string(), expected: expected.to_owned() }
}
