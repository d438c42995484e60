//! Receipts.
#![no_main]

use std::path::Path;

use guard4d_engine::release::receipt::Receipt;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    if let Ok(receipt) = Receipt::parse(Path::new("receipt.json"), data) {
        let _ = receipt.verify_commitment(Path::new("receipt.json"));
    }
});
