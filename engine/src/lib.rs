//! Scenes, rendering, CLIP, watermark and evidence of guard4d.
#![forbid(unsafe_code)]

pub mod error;
pub mod tensor_file;

pub use error::EngineError;
