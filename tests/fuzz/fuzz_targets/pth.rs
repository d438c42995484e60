//! State dicts, and the networks in them.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| guard4d_fuzz::pth(data));
