//! Camera files as JSON.
#![no_main]

use std::path::Path;

use guard4d_engine::scene::{CameraSet, FrameSize};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let size = FrameSize::new(64, 48).expect("a size");
    let _ = CameraSet::parse(Path::new("transforms.json"), data, size);
});
