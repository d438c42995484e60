//! Keys, extractors and undo files, all safetensors.
#![no_main]

use std::path::Path;

use guard4d_engine::base::tensor_file::TensorFile;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let _ = TensorFile::from_bytes(Path::new("owner.key"), data);
});
