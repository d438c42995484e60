//! PLY: binary and text, still and on paths, and packed ones.
#![no_main]

use std::path::Path;

use guard4d_engine::scene::Model;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let _ = Model::parse(Path::new("scene.ply"), data.to_vec());
});
