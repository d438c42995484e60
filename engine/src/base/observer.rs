//! Watching long work, and ending it.

use crate::error::EngineError;

/// How far a stage of long work is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress<'a> {
    /// What is worked on, for people: a file, a view, a part of a study.
    pub stage: &'a str,
    /// Pieces of it that are done.
    pub done: u64,
    /// Pieces that there seem to be, where that is known. It can be wrong: files say of themselves what they like.
    pub total: Option<u64>,
}

/// Whoever watches long work: a progress bar, a test, a worker that may lose its job.
///
/// A closure of a [`Progress`] is one, too.
pub trait Observer {
    /// Is told after every piece of work. An error ends the work before the next piece.
    ///
    /// # Errors
    /// [`EngineError::Stopped`] to cancel; whoever works passes any error on as it is.
    fn observe(&mut self, progress: Progress<'_>) -> Result<(), EngineError>;
}

impl<F: FnMut(Progress<'_>) -> Result<(), EngineError>> Observer for F {
    fn observe(&mut self, progress: Progress<'_>) -> Result<(), EngineError> {
        self(progress)
    }
}

/// Nobody: does not look and never stops anything.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unobserved;

impl Observer for Unobserved {
    fn observe(&mut self, _: Progress<'_>) -> Result<(), EngineError> {
        Ok(())
    }
}
