//! `cfg_args`.
#![no_main]

use std::path::Path;

use guard4d_engine::scene::DeformConfig;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let _ = DeformConfig::parse(Path::new("cfg_args"), data);
});
