//! Studies and tools for research on guard4d: what measures it, attacks it, and compares it with others.
//!
//! Nothing in the engine needs any of this. `guard4d lab` is the way in.
#![forbid(unsafe_code)]

pub mod chart;
pub mod command;
pub mod cross_examination;
pub mod dump;
pub mod forgery;
pub mod locating;
pub mod report;
pub mod study;
pub mod table;
pub mod tracing;
