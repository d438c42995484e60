//! Frames as the world sees them: 8-bit pictures in folders and video files.

pub mod clip;
pub mod codec;
mod decode;
pub mod encode;
pub mod ffmpeg;
pub mod folder;
pub mod frames;
pub mod framing;
mod open_exr;
pub mod source;

pub use clip::{Clip, Integrity, read_clip};
pub use frames::Frame;
pub use source::{FrameSource, ReadOptions};
