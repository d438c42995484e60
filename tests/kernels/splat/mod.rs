//! Tests of `splat`.

mod dc_colour;
mod deform;
mod hexplane;
mod project;
mod rasterize;
mod scene;
mod sh;
mod tile_bin;
mod trajectory;
mod warp;
