//! Many assets on many machines: which row is whose, what is done, and what came of it.
//!
//! Nothing here knows what a job does: the command line gives a [`runner::Jobs`] that does it.

pub mod ahead;
pub mod claim;
pub mod contents;
pub mod crowd;
pub mod forecast;
pub mod journal;
pub mod ledger;
pub mod manifest;
mod metrics;
pub mod record;
pub mod runner;
pub mod selection;
pub mod status;
pub mod submission;
