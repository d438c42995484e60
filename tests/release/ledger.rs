//! The ledger of copies: what it keeps, who may read it, and what it refuses.

use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::base::prf::MasterSecret;
use guard4d_engine::error::EngineError;
use guard4d_engine::release::issue_root::root_of;
use guard4d_engine::release::ledger::{CopyHash, Ledger, Terms};
use guard4d_engine::release::recipients::parse_list;
use tempfile::TempDir;

fn terms() -> Terms {
    Terms {
        secret: MasterSecret::from_bytes([7; 32]),
        original: Digest::of(b"an asset"),
        splats: 3,
        strength: 0.875,
        psnr_db: 49.0,
        receipt: Some(Digest::of(b"a receipt")),
    }
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder can be made")
}

fn hash(copy: u64) -> CopyHash {
    CopyHash { copy, hash: Digest::of(&copy.to_le_bytes()) }
}

/// Numbers of the copies that are taken for these names.
fn reserve(ledger: &mut Ledger, names: &[&str]) -> Result<Vec<u64>, EngineError> {
    let recipients = parse_list(names.iter().copied()).expect("names");
    Ok(ledger.reserve(&recipients)?.into_iter().map(|record| record.copy).collect())
}

#[test]
fn numbers_are_taken_once_and_outlast_the_process() {
    let folder = folder();
    let path = folder.path().join("show.ledger");
    let mut ledger = Ledger::create(&path, &terms()).expect("a ledger");
    let mode = fs::metadata(&path).expect("there").permissions().mode() & 0o777;
    assert_eq!(mode, 0o600, "its owner alone can read it");
    assert_eq!(ledger.last_number().expect("a number"), 0);
    assert_eq!(reserve(&mut ledger, &["a", "b"]).expect("numbers"), [1, 2]);
    // Nothing of b was written yet: it keeps its number.
    assert_eq!(reserve(&mut ledger, &["B", "c"]).expect("numbers"), [2, 3]);
    ledger.stamped(&[hash(1), hash(3)]).expect("written down");
    drop(ledger);

    let mut ledger = Ledger::open(&path).expect("the same ledger");
    assert_eq!(ledger.terms(), &terms());
    let copies = ledger.copies().expect("copies");
    assert_eq!(copies.iter().map(|copy| copy.recipient.as_str()).collect::<Vec<_>>(), ["a", "b", "c"]);
    assert_eq!(copies.iter().map(|copy| copy.hash.is_some()).collect::<Vec<_>>(), [true, false, true]);
    assert_eq!(ledger.of_hash(hash(3).hash).expect("asked"), Some(copies[2].clone()));
    assert_eq!(ledger.of_number(9).expect("asked"), None);
    // Who has a copy gets no second one, and neither does anybody else in that list.
    let refused = reserve(&mut ledger, &["d", "a"]).expect_err("a has one").to_string();
    assert!(refused.contains("a has copy 1") && refused.contains("--again"), "{refused}");
    assert_eq!(ledger.last_number().expect("a number"), 3, "d got none");
    // The same hash again is no change, another one is.
    ledger.stamped(&[hash(1)]).expect("the same");
    let other = CopyHash { copy: 1, ..hash(2) };
    assert!(matches!(ledger.stamped(&[other]), Err(EngineError::BadData { .. })), "another copy 1");
    assert!(matches!(ledger.stamped(&[hash(4)]), Err(EngineError::BadData { .. })), "never taken");
    let csv = String::from_utf8(ledger.csv().expect("a table")).expect("text");
    assert!(csv.starts_with("copy,recipient,hash,") && csv.lines().count() == 4, "{csv}");
    assert!(!csv.contains(&"07".repeat(8)), "no secret in it");
}

#[test]
fn only_its_own_asset_is_taken() {
    let folder = folder();
    let ledger = Ledger::create(&folder.path().join("l"), &terms()).expect("a ledger");
    ledger.check_original(Digest::of(b"an asset"), 3).expect("the same");
    for (original, splats, word) in [("another", 3, "hash of the original"), ("an asset", 4, "splats of the original")]
    {
        let error = ledger.check_original(Digest::of(original.as_bytes()), splats).expect_err(word);
        assert!(matches!(error, EngineError::BadData { .. }) && error.to_string().contains(word), "{error}");
    }
}

#[test]
fn what_is_no_ledger_is_refused_and_left_alone() {
    let folder = folder();
    let path = folder.path().join("l");
    assert!(matches!(Ledger::open(&path), Err(EngineError::MissingInput { .. })));
    for bytes in [b"".as_slice(), b"text", &[0; 4096]] {
        fs::write(&path, bytes).expect("writable");
        let error = Ledger::open(&path).expect_err("no ledger");
        assert!(matches!(error, EngineError::BadData { .. }), "{error}");
        assert_eq!(fs::read(&path).expect("readable"), bytes, "it is left as it was");
    }
    let error = Ledger::create(&path, &terms()).expect_err("something is there");
    assert!(matches!(error, EngineError::CannotCreate { .. }), "{error}");
}

#[test]
fn another_process_that_holds_it_is_waited_for_and_then_told_of() {
    let folder = folder();
    let path = folder.path().join("l");
    let mut ledger = Ledger::create(&path, &terms()).expect("a ledger");
    let holder = rusqlite::Connection::open(&path).expect("opens");
    holder.execute_batch("BEGIN IMMEDIATE").expect("held");
    let error = reserve(&mut ledger, &["a"]).expect_err("held");
    assert!(matches!(error, EngineError::Busy { .. }), "{error}");
    assert_eq!(error.exit_code(), 75);
    holder.execute_batch("ROLLBACK").expect("let go");
    assert_eq!(reserve(&mut ledger, &["a"]).expect("free again"), [1]);
}

/// A ledger with the same issue and these recipients, of which the first has its copy.
fn branch(path: &Path, from: &Path, names: &[&str]) -> Ledger {
    fs::copy(from, path).expect("copied");
    let mut ledger = Ledger::open(path).expect("opens");
    let numbers = reserve(&mut ledger, names).expect("numbers");
    ledger.stamped(&[hash(numbers[0])]).expect("written down");
    ledger
}

#[test]
fn ledgers_of_one_issue_are_merged_unless_they_clash() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    let mut ledger = Ledger::create(&at("main"), &terms()).expect("a ledger");
    reserve(&mut ledger, &["a", "b"]).expect("numbers");
    drop(ledger);
    let mut one = branch(&at("one"), &at("main"), &["a"]);
    let two = branch(&at("two"), &at("main"), &["b", "c"]);
    assert_eq!(one.merge(&two).expect("merges"), 1, "c is new");
    let written: Vec<bool> = one.copies().expect("copies").iter().map(|copy| copy.hash.is_some()).collect();
    assert_eq!(written, [true, true, false]);
    assert_eq!(one.merge(&two).expect("merges"), 0, "nothing new");
    let clashing = branch(&at("three"), &at("main"), &["d"]);
    let error = one.merge(&clashing).expect_err("3 is c's").to_string();
    assert!(error.contains("copy 3 for d") && error.contains("copy 3 for c"), "{error}");
    let other = Terms { strength: 0.5, ..terms() };
    let foreign = Ledger::create(&at("other"), &other).expect("a ledger");
    assert!(matches!(one.merge(&foreign), Err(EngineError::BadData { .. })), "another issue");
}

#[test]
fn a_root_covers_the_issue_and_every_copy_and_tells_nobody_whose() {
    let folder = folder();
    let mut ledger = Ledger::create(&folder.path().join("l"), &terms()).expect("a ledger");
    let empty = root_of(&ledger).expect("a root");
    assert_eq!(empty.receipts(), 1, "the issue alone");
    reserve(&mut ledger, &["a", "b"]).expect("numbers");
    assert_eq!(root_of(&ledger).expect("a root"), empty, "what is not written is not promised");
    ledger.stamped(&[hash(1), hash(2)]).expect("written down");
    let root = root_of(&ledger).expect("a root");
    assert_eq!(root.receipts(), 3);
    assert!(empty.commitments().iter().all(|commitment| root.covers(commitment)), "the issue is still there");
    assert!(!root.covers(&hash(1).hash), "not by the hash that a recipient knows");
}
