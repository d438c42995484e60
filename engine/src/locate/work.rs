//! How far a search is.

use crate::base::observer::{Observer, Progress};
use crate::error::EngineError;

/// How far the work is, and who is told.
pub(super) struct Work<'a> {
    pub(super) done: u64,
    pub(super) total: u64,
    pub(super) observer: &'a mut dyn Observer,
}

impl Work<'_> {
    /// Tells what is done next.
    pub(super) fn look(&mut self, stage: &str) -> Result<(), EngineError> {
        self.observer.observe(Progress { stage, done: self.done, total: Some(self.total) })
    }

    /// Tells the same, of one of all frames' two rounds.
    pub(super) fn one(&mut self, stage: &str) -> Result<(), EngineError> {
        self.done += 1;
        self.look(stage)
    }
}
