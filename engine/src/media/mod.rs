//! Frames as the world sees them: 8-bit pictures, alone, in clips, in folders and in video files.

pub mod clip;
pub mod codec;
mod decode;
pub mod encode;
pub mod ffmpeg;
pub mod folder;
pub mod frames;
pub mod framing;
mod open_exr;
pub mod options;
pub mod png;
pub mod source;

pub use clip::{Clip, read_clip};
pub use frames::{Frame, Integrity};
pub use options::ReadOptions;
pub use source::FrameSource;
