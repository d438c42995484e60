//! Scenes, rendering, CLIP, watermark and evidence of guard4d.
#![forbid(unsafe_code)]

pub mod error;

pub use error::EngineError;
