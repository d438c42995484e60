//! Frames as the world sees them: 8-bit pictures in PNG folders and video files.

pub mod clip;
pub mod decode;
pub mod encode;
pub mod ffmpeg;
pub mod frames;

pub use clip::{Clip, Integrity, ReadOptions, read_clip};
pub use frames::Frame;
