//! Gaussian splats: deformation in time, projection, colours, tile lists, blending.

pub mod dc_colour;
pub mod deform;
pub mod hexplane;
pub mod project;
pub mod rasterize;
pub mod sh;
pub mod tile_bin;
pub mod trajectory;
pub mod warp;

use crate::shape::OffsetBases;

/// Floats of one row of spherical-harmonic coefficients: all bases, 3 channels.
pub const SH_FLOATS: usize = OffsetBases::All.floats();
