//! What lies beside a receipt, and what it says about the receipt's age.

use std::fs;
use std::path::{Path, PathBuf};

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::Existing;
use guard4d_engine::error::EngineError;
use guard4d_engine::release::dating::commit::commit;
use guard4d_engine::release::dating::proof::Proof;
use guard4d_engine::release::dating::request::Request;
use guard4d_engine::release::dating::response::attach;
use guard4d_engine::release::dating::standing::{DateFiles, Standing, check};
use guard4d_engine::release::dating::subject::Subject;
use guard4d_engine::release::dating::token::Trust;
use guard4d_engine::release::receipt::Receipt;

use crate::support::authority::{Authority, P256, has_openssl, receipt};

/// Has a file dated; the token lies beside it.
fn date(authority: &Authority, file: &Path) -> PathBuf {
    let request = authority.path("request.tsq");
    let digest = Subject::read(file).expect("a file that can be dated").digest();
    Request::new(&digest).expect("random numbers").write(&request, Existing::Replace).expect("writable");
    let response = authority.reply(&request, &[]);
    attach(file, &response, Some(&request), Existing::Replace).expect("a token").path
}

fn commitment(receipt: &Path) -> Digest {
    Receipt::read(receipt).expect("a receipt").commitment
}

fn find(receipt: &Path, files: &DateFiles) -> Result<Standing, EngineError> {
    Standing::find(receipt, &commitment(receipt), files)
}

#[track_caller]
fn refused(found: Result<Standing, EngineError>, code: u8, words: &[&str]) {
    let error = found.expect_err("no such standing");
    let said = error.to_string();
    assert!(error.exit_code() == code && words.iter().all(|word| said.contains(word)), "{said}");
}

#[test]
fn without_anything_beside_it_a_receipt_has_no_date() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let standing = find(&receipt(folder.path(), "receipt", 1), &DateFiles::default()).expect("a receipt alone");
    assert_eq!((&standing, standing.receipts()), (&Standing::default(), 1), "nothing is known");
}

#[test]
fn a_token_beside_a_receipt_dates_it() {
    if !has_openssl() {
        return;
    }
    let authority = Authority::new(P256, "sha256");
    let (own, other) = (receipt(&authority.path(""), "own", 1), receipt(&authority.path(""), "other", 2));
    let token = date(&authority, &own);
    let trusting = DateFiles { authorities: vec![authority.path("ca.pem")], ..DateFiles::default() };
    for (files, trust) in [(&DateFiles::default(), Trust::Claimed), (&trusting, Trust::Checked)] {
        let standing = find(&own, files).expect("a date");
        let dated = standing.dated.as_ref().expect("a date");
        assert_eq!((dated.stamp.trust, dated.receipts, dated.of), (trust, 1, commitment(&own)), "{standing:?}");
        assert_eq!((standing.root, standing.receipts()), (None, 1), "counted once");
    }
    let of_own = DateFiles { timestamp: Some(token.clone()), ..DateFiles::default() };
    refused(find(&other, &of_own), 65, &["own.tst: TSTInfo.messageImprint"]);
    refused(find(&other, &trusting), 66, &["other.tst: not found"]);
    let foreign = Authority::new(P256, "sha256");
    let strangers = DateFiles { authorities: vec![foreign.path("ca.pem")], ..DateFiles::default() };
    refused(find(&own, &strangers), 65, &["own.tst: certificate.signature"]);
    fs::write(&token, b"no token").expect("writable");
    refused(find(&own, &DateFiles::default()), 65, &["own.tst: token"]);
}

#[test]
fn a_root_dates_its_receipts_and_counts_each_for_all() {
    if !has_openssl() {
        return;
    }
    let authority = Authority::new(P256, "sha256");
    let folder = authority.path("");
    let receipts: Vec<_> = (0..3).map(|seed| receipt(&folder, &format!("r{seed}"), seed)).collect();
    let (outside, root) = (receipt(&folder, "outside", 9), authority.path("root.json"));
    let made = commit(&receipts, &root, Existing::Refuse).expect("a root");
    // Counted as soon as the proof is there, dated or not.
    let undated = find(&receipts[0], &DateFiles::default()).expect("a proof beside it");
    assert_eq!((undated.receipts(), &undated.dated), (3, &None), "{undated:?}");
    let token = date(&authority, &root);
    let given = |root: &Path| DateFiles { root: Some(root.to_path_buf()), ..DateFiles::default() };
    let by_proof = DateFiles { timestamp: Some(token.clone()), ..DateFiles::default() };
    for files in [given(&root), by_proof] {
        let standing = find(&receipts[1], &files).expect("a date");
        let dated = standing.dated.as_ref().expect("a date");
        assert_eq!((dated.of, dated.receipts, standing.receipts()), (made.root(), 3, 3), "{standing:?}");
    }
    // All that a third party needs, in one folder.
    fs::copy(&token, Proof::beside(&receipts[1]).with_extension("tst")).expect("writable");
    let standing = find(&receipts[1], &DateFiles::default()).expect("a date");
    assert_eq!(standing.dated.map(|dated| dated.of), Some(made.root()), "found by itself");
    // A date of its own does not take the root away.
    date(&authority, &receipts[2]);
    let standing = find(&receipts[2], &DateFiles::default()).expect("a date");
    let dated = standing.dated.as_ref().expect("a date");
    assert_eq!((dated.of, dated.receipts, standing.receipts()), (commitment(&receipts[2]), 1, 3), "{standing:?}");

    refused(find(&outside, &given(&root)), 65, &["root.json: commitments", "the receipt's, among them"]);
    let foreign = given(&Proof::beside(&receipts[0]));
    refused(find(&outside, &foreign), 65, &["r0.proof.json: commitment"]);
    refused(find(&outside, &given(&receipts[0])), 65, &["r0.json: schema"]);
    refused(find(&outside, &given(&folder.join("nowhere"))), 66, &["nowhere"]);
    let wrong = fs::read_to_string(&root).expect("a root").replace("\"receipts\": 3", "\"receipts\": 1");
    fs::write(&root, wrong).expect("writable");
    refused(find(&receipts[0], &given(&root)), 65, &["root.json: receipts"]);
}

#[test]
fn a_token_is_checked_by_itself() {
    if !has_openssl() {
        return;
    }
    let authority = Authority::new(P256, "sha256");
    let own = receipt(&authority.path(""), "own", 1);
    let error = check(&own, None, &[]).expect_err("no token");
    assert_eq!(error.exit_code(), 66, "{error}");
    let token = date(&authority, &own);
    let claimed = check(&own, None, &[]).expect("a token");
    let checked = check(&own, Some(&token), &[authority.path("ca.pem")]).expect("a token");
    assert_eq!((claimed.stamp.trust, checked.stamp.trust), (Trust::Claimed, Trust::Checked), "who was asked");
    assert_eq!((claimed.of, claimed.receipts), (commitment(&own), 1), "{claimed:?}");
    assert_eq!(claimed.stamp.date, checked.stamp.date, "the same date");
}
