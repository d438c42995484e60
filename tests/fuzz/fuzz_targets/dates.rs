//! Responses and tokens of time-stamping authorities, roots and proofs.
#![no_main]

use std::path::Path;

use guard4d_engine::release::dating::proof::Proof;
use guard4d_engine::release::dating::response::token_of;
use guard4d_engine::release::dating::root::Root;
use guard4d_engine::release::dating::token::Token;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let _ = token_of(Path::new("response.tsr"), data);
    let _ = Token::parse(Path::new("receipt.tst"), data);
    let _ = Root::parse(Path::new("root.json"), data);
    let _ = Proof::parse(Path::new("receipt.proof.json"), data);
});
