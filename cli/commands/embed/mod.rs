//! `guard4d embed`

pub(crate) mod args;
mod inputs;
pub(crate) mod job;
pub(crate) mod run;
pub(crate) mod settings;
pub(crate) mod training;
