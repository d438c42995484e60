//! What a study tells of itself while it runs.

use guard4d_engine::error::EngineError;

use super::plan::{Cell, Take};

/// What a study is about to do.
#[derive(Clone, Copy, Debug)]
pub enum Step<'a> {
    /// Embedding number `index` of `len`, which is not in the ledger.
    Embedding {
        /// Arm, scene and seed.
        cell: &'a Cell,
        /// Number, from 0.
        index: usize,
        /// Embeddings of the sub-study.
        len: usize,
    },
    /// So many steps are taken.
    Training(usize),
    /// A film is made and read.
    Reading(&'a Take),
}

/// Told of every step; an error ends the study, which can be gone on with.
pub type Watcher<'a> = &'a mut dyn FnMut(Step<'_>) -> Result<(), EngineError>;
