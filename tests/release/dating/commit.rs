//! Many receipts under one root, on disk.

use std::fs;

use guard4d_engine::base::output::Existing;
use guard4d_engine::release::dating::commit::commit;
use guard4d_engine::release::dating::proof::Proof;
use guard4d_engine::release::dating::root::Root;
use guard4d_engine::release::receipt::Receipt;

use crate::support::authority::receipt;
use crate::support::names;

#[test]
fn a_root_and_a_proof_for_each_receipt_are_written() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let receipts: Vec<_> = (0..3).map(|seed| receipt(folder.path(), &format!("r{seed}"), seed)).collect();
    let out = folder.path().join("root.json");
    let root = commit(&receipts, &out, Existing::Refuse).expect("three receipts");
    assert_eq!(Root::read(&out).expect("a root"), root, "as written");
    for path in &receipts {
        let proof = Proof::read(&Proof::beside(path)).expect("a proof");
        let commitment = Receipt::read(path).expect("a receipt").commitment;
        assert_eq!((proof.commitment(), proof.root()), (commitment, root.root()), "{}", path.display());
    }
    let error = commit(&receipts, &out, Existing::Refuse).expect_err("they exist");
    assert_eq!(error.exit_code(), 73, "{error}");
    commit(&receipts[..2], &out, Existing::Replace).expect("replaced when asked");
    assert_eq!(Root::read(&out).expect("a root").receipts(), 2, "the new one");
}

#[test]
fn a_receipt_named_twice_is_refused_and_nothing_is_written() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let one = receipt(folder.path(), "one", 1);
    let copy = folder.path().join("copy.json");
    fs::copy(&one, &copy).expect("writable");
    let out = folder.path().join("root.json");
    for both in [[one.clone(), one.clone()], [one.clone(), copy]] {
        let error = commit(&both, &out, Existing::Refuse).expect_err("twice");
        assert!(error.exit_code() == 2 && error.to_string().contains("each receipt once"), "{error}");
    }
    // The second proof cannot be written, so neither is the first.
    let other = receipt(folder.path(), "other", 2);
    fs::write(Proof::beside(&other), "mine").expect("writable");
    let error = commit(&[one, other], &out, Existing::Refuse).expect_err("it exists");
    assert_eq!(error.exit_code(), 73, "{error}");
    assert_eq!(names(folder.path()), ["copy.json", "one.json", "other.json", "other.proof.json"], "nothing new");
}
