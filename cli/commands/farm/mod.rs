//! `guard4d farm`

pub(crate) mod actions;
mod init;
mod job;
mod plan;
mod report;
mod run;
mod status;
mod submit;
mod tell;
