//! Tests of `splat`.

mod bucket;
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
