//! Samples of rows, the rows, and the scenes that are made for them.

mod bench;
mod row;
pub(crate) mod scene;

pub(crate) use bench::{Bench, Effort, Outcome, SAMPLES};
pub(crate) use row::{MemoryRow, Row, Scale, Work};
