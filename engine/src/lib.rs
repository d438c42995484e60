//! Scenes, rendering, CLIP, watermark and evidence of guard4d.
#![forbid(unsafe_code)]

pub mod clip;
pub mod deform;
pub mod demo;
pub mod distortion;
pub mod dump;
pub mod error;
pub mod json;
pub mod lpips;
pub mod media;
mod natural;
pub mod output;
pub mod render;
pub mod scene;
pub mod study;
pub mod tensor_file;
pub mod train;
pub mod watermark;

pub use error::EngineError;
