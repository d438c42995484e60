//! What a run leaves behind, and what two runs say beside each other.

mod chart;
pub(crate) mod compare;
mod figures;
pub(crate) mod host;
mod stats;
mod summary;
mod target;

pub(crate) use summary::{Run, write};
