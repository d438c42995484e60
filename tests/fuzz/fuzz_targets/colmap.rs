//! COLMAP's binary files: the first byte says what share of the others are cameras.
#![no_main]

use guard4d_engine::scene::{CameraSet, FrameSize};

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let Some((share, rest)) = data.split_first() else { return };
    let (cameras, images) = rest.split_at(rest.len() * usize::from(*share) / 256);
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    std::fs::write(folder.path().join("cameras.bin"), cameras).expect("writable");
    std::fs::write(folder.path().join("images.bin"), images).expect("writable");
    let _ = CameraSet::open(folder.path(), FrameSize::new(64, 48).expect("a size"));
});
