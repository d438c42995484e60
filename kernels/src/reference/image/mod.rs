//! Twins of `glsl/image`.

pub mod clamp01;
pub mod colour_map;
pub mod crop;
pub mod noise;
pub mod normalize;
pub mod quantize;
pub mod resize;
