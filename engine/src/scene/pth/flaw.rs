//! What is wrong with a file, before its path is known.

/// What is wrong with a file, without its path.
#[derive(Debug)]
pub(super) struct Flaw {
    pub(super) field: String,
    pub(super) got: String,
    pub(super) expected: String,
}

impl Flaw {
    pub(super) fn new(field: impl Into<String>, got: impl Into<String>, expected: impl Into<String>) -> Self {
        Self { field: field.into(), got: got.into(), expected: expected.into() }
    }
}
