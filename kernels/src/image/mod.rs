//! Operations on clips `[F, H, W, 4]`: resizing, normalisation, noise, quantisation.

pub mod colour_map;
pub mod crop;
pub mod noise;
pub mod normalize;
pub mod quantize;
pub mod resize;

/// Floats of a pixel.
pub const CHANNELS: usize = 4;
