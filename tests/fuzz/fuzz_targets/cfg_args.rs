//! `cfg_args`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| guard4d_fuzz::cfg_args(data));
