//! Twins of `splat`.

pub mod bucket;
pub mod dc_colour;
pub mod deform;
pub mod hexplane;
pub mod project;
pub mod rasterize;
pub mod rules;
pub mod sh;
pub mod tile_bin;
pub mod trajectory;
pub mod traverse;
pub mod warp;
