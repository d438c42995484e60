//! PLY: binary and text, still and on paths, and packed ones.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| guard4d_fuzz::ply(data));
