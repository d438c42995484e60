//! Scenes, rendering, CLIP, watermark and evidence of guard4d.
#![forbid(unsafe_code)]

<<<<<<< HEAD
pub mod deform;
=======
pub mod clip;
>>>>>>> main
pub mod error;
pub mod media;
pub mod output;
pub mod render;
pub mod scene;
pub mod tensor_file;
pub mod watermark;

pub use error::EngineError;
