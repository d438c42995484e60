//! COLMAP's binary files: the first byte says what share of the others are cameras.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| guard4d_fuzz::colmap(data));
