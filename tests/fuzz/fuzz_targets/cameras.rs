//! Camera files as JSON.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| guard4d_fuzz::cameras(data));
