//! What an authority answers, and whether it is an answer to what was asked.

use std::fs;
use std::path::Path;

use guard4d_engine::base::output::Existing;
use guard4d_engine::release::dating::request::Request;
use guard4d_engine::release::dating::response::{attach, token_of};
use guard4d_engine::release::dating::subject::{Subject, imprint};

use crate::support::authority::{Authority, P256, has_openssl, receipt};

/// A request for a receipt, root or proof.
fn ask(authority: &Authority, file: &Path, name: &str) -> std::path::PathBuf {
    let path = authority.path(name);
    let digest = Subject::read(file).expect("a file that can be dated").digest();
    Request::new(&digest).expect("random numbers").write(&path, Existing::Replace).expect("writable");
    path
}

#[test]
fn openssl_reads_requests_as_they_are_meant() {
    if !has_openssl() {
        return;
    }
    let authority = Authority::new(P256, "sha256");
    let file = receipt(&authority.path(""), "receipt", 1);
    ask(&authority, &file, "request.tsq");
    let said = authority.openssl(&["ts", "-query", "-in", "request.tsq", "-text"]);
    for words in ["Version: 1", "Hash Algorithm: sha256", "Certificate required: yes", "Nonce: 0x"] {
        assert!(said.contains(words), "{words}:\n{said}");
    }
    let sha256 = imprint(&Subject::read(&file).expect("a receipt").digest());
    let der = fs::read(authority.path("request.tsq")).expect("a request");
    assert!(der.windows(32).any(|window| window == sha256), "the hash is what was told");
    ask(&authority, &file, "again.tsq");
    assert_ne!(der, fs::read(authority.path("again.tsq")).expect("a request"), "another random number");
}

#[test]
fn a_token_is_attached_to_what_was_asked_and_to_nothing_else() {
    if !has_openssl() {
        return;
    }
    let authority = Authority::new(P256, "sha256");
    let (one, other) = (receipt(&authority.path(""), "one", 1), receipt(&authority.path(""), "other", 2));
    let request = ask(&authority, &one, "request.tsq");
    let response = authority.reply(&request, &[]);
    let refused = |file: &Path, request: Option<&Path>, words: &[&str]| {
        let error = attach(file, &response, request, Existing::Refuse).map(|_| ()).expect_err("no answer to this");
        let said = error.to_string();
        assert!(error.exit_code() == 65 && words.iter().all(|word| said.contains(word)), "{said}");
    };
    refused(&other, None, &["response.tsr: TSTInfo.messageImprint", "the SHA-256 of"]);
    let asked_again = ask(&authority, &one, "again.tsq");
    refused(&one, Some(&asked_again), &["response.tsr: TSTInfo.nonce"]);
    let asked_other = ask(&authority, &other, "other.tsq");
    refused(&one, Some(&asked_other), &["other.tsq: messageImprint"]);
    refused(&one, Some(&response), &["response.tsr: TimeStampReq"]);
    let attached = attach(&one, &response, Some(&request), Existing::Refuse).expect("the answer");
    assert_eq!(attached.path, authority.path("one.tst"), "beside it");
    let error = attach(&one, &response, None, Existing::Refuse).map(|_| ()).expect_err("it exists");
    assert_eq!(error.exit_code(), 73, "{error}");
    attach(&one, &response, None, Existing::Replace).expect("replaced when asked");
}

#[test]
fn what_was_not_granted_is_told() {
    if !has_openssl() {
        return;
    }
    let authority = Authority::new(P256, "sha256");
    let file = receipt(&authority.path(""), "receipt", 1);
    let request = ask(&authority, &file, "request.tsq");
    let config = fs::read_to_string(authority.path("openssl.cnf")).expect("a file");
    authority.put("openssl.cnf", config.replace("digests = sha256", "digests = sha512").as_bytes());
    let response = authority.reply(&request, &[]);
    let error = attach(&file, &response, None, Existing::Refuse).map(|_| ()).expect_err("rejected");
    let said = error.to_string();
    assert!(said.contains("response.tsr: status: 2 (rejection)") && said.contains("not supported"), "{said}");
    assert!(!authority.path("receipt.tst").exists(), "nothing is written");
    let der = fs::read(&response).expect("a response");
    for length in 0..der.len() {
        assert!(token_of(&response, &der[..length]).is_err(), "{length} bytes");
    }
}
