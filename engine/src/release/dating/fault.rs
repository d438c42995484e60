//! What is wrong with a part of a file, before it is said which file.

use std::fmt::Display;
use std::path::Path;

use crate::base::files::bad_data;
use crate::error::EngineError;

/// Text without control characters: names in certificates come from anywhere, and are shown in terminals.
pub(super) fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c }).collect()
}

/// A field that holds something other than it should.
#[derive(Debug)]
pub(super) struct Fault {
    field: &'static str,
    got: String,
    expected: String,
}

impl Fault {
    /// `got` in `field` where `expected` should be.
    pub(super) fn new(field: &'static str, got: impl Display, expected: impl Display) -> Self {
        Self { field, got: printable(&got.to_string()), expected: printable(&expected.to_string()) }
    }

    /// For `map_err` of what parses `field`.
    pub(super) fn parsing(field: &'static str, expected: &'static str) -> impl Fn(der::Error) -> Self {
        move |error| Self::new(field, error, expected)
    }

    /// The error about the file at `path`.
    pub(super) fn at(self, path: &Path) -> EngineError {
        bad_data(path, self.field, self.got, self.expected)
    }
}
