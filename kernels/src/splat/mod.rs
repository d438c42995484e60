//! Gaussian splats: deformation in time, projection, colours, tile lists, blending.

pub mod bucket;
pub mod dc_colour;
pub mod deform;
pub mod hexplane;
pub mod project;
pub mod rasterize;
pub mod rules;
pub mod sh;
pub mod tile_bin;
pub mod tile_grid;
pub mod trajectory;
pub mod warp;

pub use sh::SH_FLOATS;
