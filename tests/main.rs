//! All integration tests in one binary: one link, shared helpers.
//!
//! A folder stands for a room of the engine and has its stems: `evidence/statistics.rs` tests
//! `engine/src/evidence/statistics.rs`. Where one file has tests of several kinds, they stand in a folder of its stem;
//! where several rooms work together, in `pipeline`. `kernels`, `cli` and `lab` test what bears these names.

#![allow(clippy::cast_possible_truncation, reason = "test sizes are small")]

mod assets;
mod base;
mod benches;
mod ci;
mod cli;
mod damaged;
mod detect;
mod docs;
mod evidence;
mod farm;
mod fingerprint;
mod kernels;
mod lab;
mod locate;
mod media;
mod networks;
mod picture;
mod pipeline;
mod release;
mod render;
mod scene;
mod support;
mod tidy;
mod watermark;
