//! glTF binaries.
#![no_main]

use std::path::Path;

use guard4d_engine::scene::Model;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let _ = Model::parse(Path::new("scene.glb"), data.to_vec());
});
