mod clamp01;
mod colour_map;
mod noise;
mod normalize;
mod quantize;
mod resize;

use super::nn::{dot, run, unwritten, upload};
