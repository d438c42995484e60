//! The way from a token to somebody who is trusted.

use std::fs;
use std::path::Path;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::Existing;
use guard4d_engine::release::dating::authorities::Authorities;
use guard4d_engine::release::dating::request::Request;
use guard4d_engine::release::dating::response::token_of;
use guard4d_engine::release::dating::token::Token;

use crate::support::authority::{Authority, P256, has_openssl};

fn token(authority: &Authority, more: &[&str]) -> Token {
    let request = authority.path("request.tsq");
    let asked = Request::new(&Digest::of(b"a commitment")).expect("random numbers");
    asked.write(&request, Existing::Replace).expect("writable");
    let response = authority.reply(&request, more);
    token_of(&response, &fs::read(&response).expect("a response")).expect("a token")
}

/// What is wrong with a token when the certificates `names` are trusted; none if all is well.
fn wrong(authority: &Authority, token: &Token, names: &[&str]) -> Option<String> {
    let paths: Vec<_> = names.iter().map(|name| authority.path(name)).collect();
    let trusted = Authorities::read(&paths).expect("certificates").expect("some are given");
    token.check_authority(Path::new("a.tst"), &trusted).err().map(|error| error.to_string())
}

#[test]
fn a_way_may_lead_over_others_and_ends_at_one_that_is_trusted() {
    if !has_openssl() {
        return;
    }
    let authority = Authority::new(P256, "sha256");
    let other = Authority::new(P256, "sha256");
    fs::copy(other.path("ca.pem"), authority.path("other.pem")).expect("writable");
    let direct = token(&authority, &[]);
    assert_eq!(wrong(&authority, &direct, &["ca.pem"]), None, "a good token");
    assert_eq!(wrong(&authority, &direct, &["other.pem", "ca.pem"]), None, "one of several");
    // Of the same name, but with another key.
    let said = wrong(&authority, &direct, &["other.pem"]).expect("another authority");
    assert!(said.contains("certificate.signature") && said.contains("a.tst"), "{said}");

    for (middle, section) in [("middle", "short"), ("stranger", "bare"), ("web", "web")] {
        authority.key(P256, middle);
        authority.certify(middle, section, "ca");
    }
    authority.certify("tsa", "stamps", "middle");
    let over = token(&authority, &["-chain", "middle.pem"]);
    assert_eq!(wrong(&authority, &over, &["ca.pem"]), None, "over another");
    assert_eq!(wrong(&authority, &over, &["middle.pem"]), None, "up to the one that is trusted");
    let said = wrong(&authority, &over, &["other.pem"]).expect("another authority");
    assert!(said.contains("certificate.signature"), "{said}");
    let alone = token(&authority, &[]);
    let said = wrong(&authority, &alone, &["ca.pem"]).expect("a gap");
    assert!(said.contains("authority: ") && said.contains("given by --ca"), "{said}");

    // Who may not issue, has not issued.
    authority.certify("tsa", "stamps", "stranger");
    let said = wrong(&authority, &token(&authority, &["-chain", "stranger.pem"]), &["ca.pem"]).expect("no issuer");
    assert!(said.contains("certificate.issuer") && said.contains("not for issuing"), "{said}");
    // One that may issue certificates, but not others that do.
    authority.key(P256, "deep");
    authority.certify("deep", "ca", "middle");
    authority.certify("tsa", "stamps", "deep");
    let chain = ["deep.pem", "middle.pem"].map(|name| fs::read_to_string(authority.path(name)).expect("a file"));
    authority.put("chain.pem", chain.concat().as_bytes());
    let said = wrong(&authority, &token(&authority, &["-chain", "chain.pem"]), &["ca.pem"]).expect("too long a way");
    assert!(said.contains("certificate.issuer") && said.contains("1 issuers below it"), "{said}");
}

#[test]
fn certificates_are_read_in_pem_and_der() {
    if !has_openssl() {
        return;
    }
    let authority = Authority::new(P256, "sha256");
    authority.openssl(&["x509", "-in", "ca.pem", "-outform", "DER", "-out", "ca.der"]);
    authority.openssl(&["x509", "-in", "ca.pem", "-text", "-out", "told.pem"]);
    let both = ["tsa.pem", "ca.pem"].map(|name| fs::read_to_string(authority.path(name)).expect("a file"));
    authority.put("both.pem", both.concat().as_bytes());
    let stamped = token(&authority, &[]);
    for name in ["ca.pem", "ca.der", "told.pem", "both.pem"] {
        assert_eq!(wrong(&authority, &stamped, &[name]), None, "{name}");
    }
    let none: [&Path; 0] = [];
    assert!(Authorities::read(&none).expect("nothing to read").is_none(), "nobody is trusted");
    for (bytes, code) in [(&b""[..], 65), (b"words", 65), (b"-----BEGIN CERTIFICATE-----\nAA", 65)] {
        let path = authority.put("broken.pem", bytes);
        let error = Authorities::read(&[&path]).expect_err("no certificate");
        assert!(error.exit_code() == code && error.to_string().contains("broken.pem: certificates"), "{error}");
    }
    let error = Authorities::read(&[authority.path("nowhere")]).expect_err("no file");
    assert_eq!(error.exit_code(), 66, "{error}");
}
