//! Tokens that openssl makes: read, and refused when anything about them is another.

use std::fs;
use std::path::{Path, PathBuf};

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::Existing;
use guard4d_engine::error::EngineError;
use guard4d_engine::release::dating::authorities::Authorities;
use guard4d_engine::release::dating::request::Request;
use guard4d_engine::release::dating::response::token_of;
use guard4d_engine::release::dating::token::{Token, Trust};

use crate::support::authority::{Authority, P256, P384, RSA, has_openssl};
use crate::support::random::Random;

/// A token for `digest`, and where it lies.
fn stamped(authority: &Authority, digest: &Digest) -> (Token, PathBuf) {
    let request = authority.path("request.tsq");
    Request::new(digest).expect("random numbers").write(&request, Existing::Replace).expect("writable");
    let response = authority.reply(&request, &[]);
    let token = token_of(&response, &fs::read(&response).expect("a response")).expect("a token");
    let path = authority.path("token.tst");
    token.write(&path, Existing::Replace).expect("writable");
    (token, path)
}

fn trusted(authority: &Authority, name: &str) -> Authorities {
    Authorities::read(&[authority.path(name)]).expect("a certificate").expect("one is given")
}

/// As a verifier goes about it.
fn verdict(der: &[u8], digest: &Digest, authorities: &Authorities) -> Result<Token, EngineError> {
    let path = Path::new("a.tst");
    let token = Token::parse(path, der)?;
    token.check_imprint(path, digest)?;
    token.check_authority(path, authorities)?;
    Ok(token)
}

/// The error about a token, which has to name the file and hold all of `words`.
#[track_caller]
fn refused(found: Result<Token, EngineError>, words: &[&str]) {
    let error = found.map(|_| ()).expect_err("no such token");
    let said = error.to_string();
    assert_eq!(error.exit_code(), 65, "{said}");
    assert!(said.starts_with("a.tst: ") && words.iter().all(|word| said.contains(word)), "{said}");
}

#[test]
fn tokens_of_rsa_and_of_both_curves_are_believed_by_us_and_by_openssl() {
    if !has_openssl() {
        return;
    }
    let digest = Digest::of(b"a commitment");
    for (kind, hash) in [(RSA, "sha256"), (RSA, "sha512"), (P256, "sha256"), (P256, "sha512"), (P384, "sha384")] {
        let authority = Authority::new(kind, hash);
        let (_, path) = stamped(&authority, &digest);
        let der = fs::read(&path).expect("a token");
        let token = verdict(&der, &digest, &trusted(&authority, "ca.pem")).expect("a good token");
        let stamp = token.stamp(Trust::Checked);
        assert_eq!((stamp.accuracy_s, stamp.policy.as_str()), (Some(1.5), "1.2.3.4.1"), "{stamp:?}");
        assert!(stamp.authority.contains("The tsa") && stamp.date.ends_with('Z'), "{stamp:?}");
        // The same by somebody else's program.
        authority.put("commitment.bin", digest.as_bytes());
        let verify = ["ts", "-verify", "-data", "commitment.bin", "-in", "token.tst", "-token_in", "-CAfile", "ca.pem"];
        let said = authority.openssl(&verify);
        assert!(said.contains("Verification: OK"), "{said}");
        refused(verdict(&der, &Digest::of(b"another"), &trusted(&authority, "ca.pem")), &["TSTInfo.messageImprint"]);
        // A certificate that is trusted needs nobody above it.
        verdict(&der, &digest, &trusted(&authority, "tsa.pem")).expect("a token of a trusted certificate");
    }
}

#[test]
fn no_flipped_bit_and_no_cut_is_believed() {
    if !has_openssl() {
        return;
    }
    let digest = Digest::of(b"a commitment");
    for kind in [RSA, P256] {
        let authority = Authority::new(kind, "sha256");
        let trusted = trusted(&authority, "ca.pem");
        let der = fs::read(stamped(&authority, &digest).1).expect("a token");
        assert!(verdict(&der, &digest, &trusted).is_ok(), "as it is");
        let mut random = Random(7);
        for _ in 0..600 {
            let mut flipped = der.clone();
            let bit = random.below(8 * der.len());
            flipped[bit / 8] ^= 1 << (bit % 8);
            refused(verdict(&flipped, &digest, &trusted), &[]);
        }
        for length in (0..der.len()).step_by(7) {
            refused(verdict(&der[..length], &digest, &trusted), &[]);
        }
        refused(verdict(&[&der[..], &[0]].concat(), &digest, &trusted), &["token"]);
        refused(verdict(&vec![0x30; 1 << 17], &digest, &trusted), &["size", "at most 65536"]);
    }
}

#[test]
fn whoever_signs_has_to_be_there_for_dates() {
    if !has_openssl() {
        return;
    }
    let digest = Digest::of(b"a commitment");
    let authority = Authority::new(P256, "sha256");
    let trusted = trusted(&authority, "ca.pem");
    // Before there is a date, or it would lie before the certificates.
    for section in ["bare", "lax", "web", "encrypts", "unknown", "stamps"] {
        authority.key(P256, section);
        authority.certify(section, section, "ca");
    }
    let content = authority.content(&stamped(&authority, &digest).1);
    let signed_by = |name: &str, more: &[&str]| verdict(&authority.sign(&content, name, more), &digest, &trusted);
    // What openssl's general program signs is a token too, if all is as it should be.
    signed_by("tsa", &["-cades"]).expect("a good token");
    refused(signed_by("tsa", &[]), &["signedAttrs.signingCertificate"]);
    refused(signed_by("tsa", &["-cades", "-nocerts"]), &["none of the signer"]);
    refused(signed_by("tsa", &["-noattr"]), &["signedAttrs.contentType"]);
    for (section, words) in [
        ("bare", ["certificate.extKeyUsage", "none"]),
        ("lax", ["certificate.extKeyUsage", "not critical"]),
        ("web", ["certificate.extKeyUsage", "other purposes"]),
        ("encrypts", ["certificate.keyUsage", "not for signatures"]),
        ("unknown", ["certificate.extensions", "1.2.3.4.5"]),
    ] {
        refused(signed_by(section, &["-cades"]), &words);
    }
    // Two who sign are one too many.
    let both = ["-cades", "-signer", "stamps.pem", "-inkey", "stamps.key"];
    refused(signed_by("tsa", &both), &["token.signerInfos: 2"]);
}

#[test]
fn the_date_has_to_lie_within_the_certificates() {
    if !has_openssl() {
        return;
    }
    let digest = Digest::of(b"a commitment");
    let authority = Authority::new(P256, "sha256");
    let trusted = trusted(&authority, "ca.pem");
    let (token, path) = stamped(&authority, &digest);
    let content = authority.content(&path);
    let date = token.stamp(Trust::Claimed).date.replace(['-', ':', 'T'], "");
    let at = content.windows(date.len()).position(|window| window == date.as_bytes()).expect("the date is in there");
    let dated = |text: &str| {
        assert_eq!(text.len(), date.len(), "as long as the date that it replaces");
        let content = [&content[..at], text.as_bytes(), &content[at + date.len()..]].concat();
        verdict(&authority.sign(&content, "tsa", &["-cades"]), &digest, &trusted)
    };
    dated(&date).expect("the same date");
    for long in ["19990101000000Z", "20700101000000Z"] {
        refused(dated(long), &["certificate.validity", "The tsa", "is valid from"]);
    }
    for odd in ["20261301000000Z", "20260230000000Z", "2026010100000Z0", "202601010000+01", "20260101000000A"] {
        refused(dated(odd), &["TSTInfo.genTime"]);
    }
    for early in ["202601010000.5Z", "2026010100.123Z"] {
        refused(dated(early), &["TSTInfo.genTime"]);
    }
}

#[test]
fn fractions_of_seconds_are_kept() {
    if !has_openssl() {
        return;
    }
    let digest = Digest::of(b"a commitment");
    let authority = Authority::new(P256, "sha256");
    let config = fs::read_to_string(authority.path("openssl.cnf")).expect("a file");
    authority.put("openssl.cnf", format!("{config}clock_precision_digits = 6\ness_cert_id_alg = sha1\n").as_bytes());
    // A fraction's last digits are left out where they are 0, but not always all six.
    let (token, _) = stamped(&authority, &digest);
    let stamp = token.stamp(Trust::Claimed);
    let fraction = stamp.date.split_once('.').map_or("", |(_, rest)| rest.trim_end_matches('Z'));
    assert!((1..=6).contains(&fraction.len()), "{stamp:?}");
    token.check_authority(Path::new("a.tst"), &trusted(&authority, "ca.pem")).expect("a token that names by SHA-1");
}
