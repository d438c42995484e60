//! Tests of `splat`.

mod deform;
mod hexplane;
mod project;
mod rasterize;
mod scene;
mod sh;
mod tile_bin;
