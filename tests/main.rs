//! All integration tests in one binary: one link, shared helpers.

#![allow(clippy::cast_possible_truncation, reason = "test sizes are small")]

mod assets;
mod benches;
mod cli;
mod clip;
mod distortion;
mod kernels;
mod lpips;
mod media;
mod pipeline;
mod render;
mod scene;
mod study;
mod support;
mod tidy;
mod watermark;
