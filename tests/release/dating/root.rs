//! Root files and proofs: read back, and refused when changed.

use std::path::Path;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::output::Existing;
use guard4d_engine::release::dating::proof::Proof;
use guard4d_engine::release::dating::root::Root;
use serde_json::{Value, json};

fn root() -> Root {
    Root::new((0..5_u8).map(|i| Digest::of(&[i])).collect()).expect("five commitments")
}

/// The root as JSON, changed.
fn changed(change: impl Fn(&mut Value)) -> String {
    let mut value = serde_json::to_value(root()).expect("JSON");
    change(&mut value);
    let json = serde_json::to_vec(&value).expect("JSON");
    Root::parse(Path::new("root.json"), &json).map(|_| ()).expect_err("a changed root").to_string()
}

#[test]
fn a_root_is_read_back_and_covers_its_receipts_alone() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let (path, root) = (folder.path().join("root.json"), root());
    root.write(&path, Existing::Refuse).expect("writable");
    assert_eq!(Root::read(&path).expect("a root"), root, "read back");
    assert_eq!(root.receipts(), 5, "all of them");
    assert!(root.commitments().is_sorted() && root.commitments().iter().all(|one| root.covers(one)), "{root:?}");
    assert!(!root.covers(&Digest::of(b"another")), "no other");
    let reversed = Root::new(root.commitments().iter().rev().copied().collect()).expect("five commitments");
    assert_eq!(reversed, root, "the order in which they were named does not matter");
    let error = root.write(&path, Existing::Refuse).expect_err("it exists");
    assert_eq!(error.exit_code(), 73, "{error}");
}

#[test]
fn changed_roots_are_refused() {
    let said = changed(|root| root["receipts"] = 4.into());
    assert!(said.contains("receipts: 4, expected 5, the number of commitments"), "{said}");
    let said = changed(|root| root["commitments"][1] = json!(Digest::of(b"another")));
    assert!(said.contains("root.json: root") || said.contains("commitments"), "{said}");
    let said = changed(|root| {
        root["commitments"].as_array_mut().expect("a list").pop();
        root["receipts"] = 4.into();
    });
    assert!(said.contains("the root of the commitments"), "{said}");
    let said = changed(|root| root["commitments"][1] = root["commitments"][0].clone());
    assert!(said.contains("in order, each once"), "{said}");
    let said = changed(|root| {
        root["commitments"] = json!([]);
        root["receipts"] = 0.into();
    });
    assert!(said.contains("at least one"), "{said}");
    assert!(changed(|root| root["schema"] = "guard4d.root/9".into()).contains("guard4d.root"), "another version");
    assert!(changed(|root| root["note"] = 1.into()).contains("note"), "a field that is not known");
    let twice = Root::new(vec![Digest::of(b"a"), Digest::of(b"b"), Digest::of(b"a")]).expect_err("twice");
    assert!(twice.to_string().contains("twice") && twice.exit_code() == 2, "{twice}");
    assert_eq!(Root::new(Vec::new()).expect_err("none").exit_code(), 2, "nothing has no root");
}

#[test]
fn a_proof_shows_one_receipt_and_names_no_other() {
    let root = root();
    let proofs = root.proofs();
    assert_eq!(proofs.len(), 5, "one for each");
    for (commitment, proof) in root.commitments().iter().zip(&proofs) {
        let json = serde_json::to_vec(proof).expect("JSON");
        assert_eq!(Proof::parse(Path::new("p.json"), &json).expect("a proof"), *proof, "read back");
        assert_eq!((proof.root(), proof.receipts(), proof.commitment()), (root.root(), 5, *commitment), "{proof:?}");
        let text = String::from_utf8(json).expect("JSON is text");
        let named = root.commitments().iter().filter(|one| text.contains(&one.to_string())).count();
        assert_eq!(named, 1, "its own: {text}");
    }
}

#[test]
fn changed_proofs_are_refused() {
    let root = root();
    let proof = &root.proofs()[2];
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut value = serde_json::to_value(proof).expect("JSON");
        change(&mut value);
        let json = serde_json::to_vec(&value).expect("JSON");
        Proof::parse(Path::new("proof.json"), &json).map(|_| ()).expect_err("a changed proof").to_string()
    };
    let other = json!(Digest::of(b"another"));
    for field in ["commitment", "root"] {
        let said = changed(&|proof| proof[field] = other.clone());
        assert!(said.contains("where commitment, index, receipts and path lead"), "{field}: {said}");
    }
    let said = changed(&|proof| proof["path"][0] = other.clone());
    assert!(said.contains("proof.json: root"), "{said}");
    for count in [1, 2, 4, 6, 5000, u32::MAX] {
        changed(&|proof| proof["receipts"] = count.into());
    }
    changed(&|proof| proof["index"] = 3.into());
    changed(&|proof| proof["index"] = 7.into());
    changed(&|proof| _ = proof["path"].as_array_mut().expect("a list").pop());
}
