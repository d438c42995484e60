//! Operations on clips `[F, H, W, 4]`: resizing, warps, colours, and what copies do to them: noise, quantisation, JPEG.

pub mod chroma420;
pub mod colour_map;
pub mod crop;
mod frames;
pub mod jpeg;
pub mod levels;
pub mod noise;
pub mod normalize;
pub mod quantize;
pub mod resize;
pub mod warp;

pub use frames::CHANNELS;
