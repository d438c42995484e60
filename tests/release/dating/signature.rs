//! Keys and hashes that are too weak to be believed.

use std::fs;
use std::path::Path;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::Existing;
use guard4d_engine::release::dating::request::Request;
use guard4d_engine::release::dating::response::token_of;
use guard4d_engine::release::dating::token::Token;

use crate::support::authority::{Authority, P256, has_openssl};

#[test]
fn short_keys_old_hashes_and_other_schemes_are_refused() {
    if !has_openssl() {
        return;
    }
    let authority = Authority::new(P256, "sha256");
    let request = authority.path("request.tsq");
    let asked = Request::new(&Digest::of(b"a commitment")).expect("random numbers");
    asked.write(&request, Existing::Refuse).expect("writable");
    let response = authority.reply(&request, &[]);
    let token = token_of(&response, &fs::read(&response).expect("a response")).expect("a token");
    token.write(&authority.path("token.tst"), Existing::Refuse).expect("writable");
    let content = authority.content(&authority.path("token.tst"));
    authority.key(["-algorithm", "RSA", "-pkeyopt", "rsa_keygen_bits:1024"], "short");
    authority.key(["-algorithm", "RSA", "-pkeyopt", "rsa_keygen_bits:3072"], "long");
    authority.key(["-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:secp256k1"], "curve");
    for name in ["short", "long", "curve"] {
        authority.certify(name, "stamps", "ca");
    }
    let signed = |name: &str, more: &[&str]| {
        let der = authority.sign(&content, name, &[&["-cades"], more].concat());
        Token::parse(Path::new("a.tst"), &der).map(|_| ()).map_err(|error| error.to_string())
    };
    for hash in ["sha256", "sha384", "sha512"] {
        assert_eq!(signed("long", &["-md", hash]), Ok(()), "RSA with {hash}");
        assert_eq!(signed("tsa", &["-md", hash]), Ok(()), "P-256 with {hash}");
    }
    for (name, more, word) in [
        ("short", &["-md", "sha256"][..], "signerInfo.signature"),
        ("curve", &["-md", "sha256"], "signerInfo.signature"),
        ("long", &["-md", "sha1"], "signerInfo.digestAlgorithm"),
        ("long", &["-md", "sha256", "-keyopt", "rsa_padding_mode:pss"], "signerInfo.signature"),
    ] {
        let said = signed(name, more).expect_err("too weak, or not read");
        assert!(said.contains(word), "{name} {more:?}: {said}");
    }
}
