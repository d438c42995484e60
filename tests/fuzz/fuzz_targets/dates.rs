//! Responses and tokens of time-stamping authorities, roots and proofs.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| guard4d_fuzz::dates(data));
