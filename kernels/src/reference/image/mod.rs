//! Twins of `glsl/image`.

pub mod chroma420;
pub mod colour_map;
pub mod crop;
pub mod jpeg;
pub mod levels;
pub mod noise;
pub mod normalize;
pub mod quantize;
mod range;
pub mod resize;
pub mod warp;

pub use range::{clamp, gate};
