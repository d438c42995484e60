//! `guard4d commit`.

use super::{guard4d, names, put, scratch};
use crate::support::authority::receipt;

#[test]
fn commit_writes_a_root_and_proofs() {
    let folder = scratch();
    let (one, two) = (receipt(folder.path(), "one", 1), receipt(folder.path(), "two", 2));
    let out = folder.path().join("root.json");
    let run = guard4d(&[&"commit", &one, &two, &"--out", &out, &"--json"]);
    run.done();
    let made: serde_json::Value = serde_json::from_str(&run.stdout).expect("JSON on stdout");
    let root: serde_json::Value = serde_json::from_slice(&std::fs::read(&out).expect("a root")).expect("JSON");
    assert_eq!((&made["root"], &made["receipts"]), (&root["root"], &2.into()), "{made}");
    assert_eq!(
        names(folder.path()),
        ["one.json", "one.proof.json", "root.json", "two.json", "two.proof.json"],
        "nothing else"
    );
    guard4d(&[&"commit", &one, &two, &"--out", &out]).refused(73, &["one.proof.json", "it exists"]);
    let run = guard4d(&[&"commit", &one, &"--out", &out, &"-w"]);
    run.done();
    assert!(run.stdout.contains("receipts  1"), "{}", run.stdout);
}

#[test]
fn commit_refuses_what_is_no_receipt() {
    let folder = scratch();
    let (one, out) = (receipt(folder.path(), "one", 1), folder.path().join("root.json"));
    guard4d(&[&"commit", &"--out", &out]).refused(2, &["<RECEIPT>..."]);
    guard4d(&[&"commit", &one]).refused(2, &["--out <FILE>"]);
    guard4d(&[&"commit", &one, &one, &"--out", &out]).refused(2, &["each receipt once"]);
    guard4d(&[&"commit", &folder.path().join("nowhere"), &"--out", &out]).refused(66, &["nowhere: not found"]);
    let broken = put(folder.path(), "broken.json", b"{}");
    guard4d(&[&"commit", &one, &broken, &"--out", &out]).refused(65, &["broken.json: receipt"]);
    assert_eq!(names(folder.path()), ["broken.json", "one.json"], "nothing is written");
}
