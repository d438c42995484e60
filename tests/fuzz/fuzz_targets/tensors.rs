//! Keys, extractors and undo files, all safetensors.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| guard4d_fuzz::tensors(data));
