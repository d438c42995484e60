//! Studies: how well marks are read, against what they cost, and where that fails.
//!
//! A sub-study is a list of arms; every arm is embedded in every scene with every seed, and read from decoded 8-bit
//! frames of views and times that training never saw. Rows go into one ledger as soon as they are measured, so that a
//! run that is broken off goes on where it was and embeddings that several sub-studies need are made once. Tables and
//! charts are made from the ledger, or again from the rows that a report left.

mod found;
mod lab;
mod parts;
mod plan;
mod progress;
mod row;
mod run;
mod scene;
mod summary;

pub use lab::OpenDevice;
pub use parts::{SUBSTUDIES, Substudy};
pub use plan::{Arm, Cell, Machine, Scale, Take};
pub use progress::{Step, Watcher};
pub use row::Row;
pub use run::{Study, redraw, substudies_in};
pub use scene::{SceneSource, Variant};
