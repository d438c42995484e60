//! Contents: a change of a name or of a byte is seen.

use std::fs;

use guard4d_engine::error::EngineError;
use guard4d_engine::farm::contents::Contents;

#[test]
fn names_and_bytes_of_all_files_count() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("a/deep")).expect("writable");
    fs::write(at("a/one"), b"1").expect("writable");
    fs::write(at("a/deep/two"), b"2").expect("writable");
    let of = |name: &str| Contents::of(&at(name)).expect("readable");
    let before = of("a");
    assert_eq!((&before, before.digest()), (&of("a"), of("a").digest()));
    fs::rename(at("a/one"), at("a/uno")).expect("writable");
    assert_ne!(before.digest(), of("a").digest(), "another name");
    fs::rename(at("a/uno"), at("a/one")).expect("writable");
    fs::write(at("a/deep/two"), b"3").expect("writable");
    assert_ne!(before.digest(), of("a").digest(), "another byte");
    assert_ne!(of("a/one"), of("a/deep/two"), "files");
    assert!(matches!(Contents::of(&at("none")), Err(EngineError::MissingInput { .. })), "nothing there");
}
