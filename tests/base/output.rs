//! Outputs appear whole or not at all.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use guard4d_engine::base::output::{AtomicDir, AtomicFile, Existing, remove_partials};
use guard4d_engine::error::EngineError;

use crate::support::names;

fn text(path: PathBuf) -> String {
    fs::read_to_string(path).expect("the file is there")
}

fn fill(dir: &AtomicDir, content: &str) {
    fs::create_dir(dir.path().join("deep")).expect("the partial folder is writable");
    fs::write(dir.path().join("deep/file"), content).expect("the partial folder is writable");
}

fn assert_cannot_create<T: std::fmt::Debug>(result: Result<T, EngineError>, word: &str) {
    let error = result.expect_err("the output cannot be created");
    assert_eq!(error.exit_code(), 73, "{error}");
    assert!(error.to_string().contains(word), "`{word}` is not in `{error}`");
}

#[test]
fn what_killed_runs_left_of_an_output_is_removed_and_nothing_else() {
    let place = tempfile::tempdir().expect("a temporary folder can be made");
    let at = |name: &str| place.path().join(name);
    for file in [".a.partial-7", ".a.partial-7-1", ".a.glb.partial-7", ".ab.partial-7", "a.glb", ".a"] {
        fs::write(at(file), file).expect("writable");
    }
    fs::create_dir_all(at(".a.old-9/deep")).expect("writable");
    remove_partials(&at("a")).expect("removable");
    assert_eq!(names(place.path()), [".a", ".a.glb.partial-7", ".ab.partial-7", "a.glb"]);
    remove_partials(&at("none/a")).expect("nothing is there");
}

#[test]
fn a_folder_appears_at_commit_under_its_name_only() {
    let place = tempfile::tempdir().expect("a temporary folder can be made");
    let target = place.path().join("new/out");
    let dir = AtomicDir::create(&target, Existing::Refuse).expect("the place is free");
    fill(&dir, "first");
    let partial = format!(".out.partial-{}", std::process::id());
    assert_eq!(names(&place.path().join("new")), [partial], "nothing under the final name yet");
    dir.commit().expect("the folder can be renamed");
    assert_eq!(names(&place.path().join("new")), ["out"]);
    assert_eq!(text(target.join("deep/file")), "first");
}

#[test]
fn a_folder_that_is_not_committed_leaves_nothing() {
    let place = tempfile::tempdir().expect("a temporary folder can be made");
    let dir = AtomicDir::create(&place.path().join("out"), Existing::Refuse).expect("the place is free");
    fill(&dir, "half");
    drop(dir);
    assert_eq!(names(place.path()), [""; 0]);
}

#[test]
fn existing_outputs_are_replaced_only_on_request_and_only_at_commit() {
    let place = tempfile::tempdir().expect("a temporary folder can be made");
    let target = place.path().join("out");
    let write = |existing: Existing, content: &str| -> Result<AtomicDir, EngineError> {
        let dir = AtomicDir::create(&target, existing)?;
        fill(&dir, content);
        Ok(dir)
    };
    write(Existing::Refuse, "first").expect("free").commit().expect("renamed");
    assert_cannot_create(write(Existing::Refuse, "second"), "--overwrite");
    let second = write(Existing::Replace, "second").expect("may be replaced");
    assert_eq!(text(target.join("deep/file")), "first", "the old output stays until commit");
    second.commit().expect("replaced");
    assert_eq!(text(target.join("deep/file")), "second");
    assert_eq!(names(place.path()), ["out"], "the old output is gone");
    drop(write(Existing::Replace, "third").expect("may be replaced"));
    assert_eq!(text(target.join("deep/file")), "second", "an abandoned output replaces nothing");
}

#[test]
fn an_output_that_appears_meanwhile_is_not_overwritten() {
    let place = tempfile::tempdir().expect("a temporary folder can be made");
    let target = place.path().join("out");
    let dir = AtomicDir::create(&target, Existing::Refuse).expect("the place is free");
    fs::write(&target, "somebody else's").expect("the place is writable");
    assert_cannot_create(dir.commit(), "exists");
    assert_eq!(names(place.path()), ["out"], "the partial folder is gone");
    assert_eq!(text(target), "somebody else's");
}

#[test]
fn files_follow_the_same_rules() {
    let place = tempfile::tempdir().expect("a temporary folder can be made");
    let target = place.path().join("key.bin");
    AtomicFile::write(&target, Existing::Refuse, b"first").expect("the place is free");
    assert_cannot_create(AtomicFile::write(&target, Existing::Refuse, b"second"), "--overwrite");
    AtomicFile::write(&target, Existing::Replace, b"second").expect("may be replaced");
    assert_eq!(text(target.clone()), "second");
    let mut third = AtomicFile::create(&target, Existing::Replace).expect("may be replaced");
    third.file().write_all(b"third").expect("the partial file is writable");
    assert_eq!(fs::read(third.path()).expect("it is there"), b"third");
    drop(third);
    assert_eq!((names(place.path()), text(target)), (vec!["key.bin".to_owned()], "second".to_owned()));
}

#[test]
fn two_outputs_of_one_name_do_not_share_a_partial_name() {
    let place = tempfile::tempdir().expect("a temporary folder can be made");
    let target = place.path().join("out");
    let one = AtomicFile::create(&target, Existing::Replace).expect("the place is free");
    let two = AtomicFile::create(&target, Existing::Replace).expect("the place is still free");
    assert_ne!(one.path(), two.path());
    two.commit().expect("renamed");
    one.commit().expect("renamed over the other");
    assert_eq!(names(place.path()), ["out"]);
}

#[test]
fn impossible_places_are_refused_with_the_reason() {
    let place = tempfile::tempdir().expect("a temporary folder can be made");
    let file = place.path().join("file");
    fs::write(&file, "").expect("the place is writable");
    assert_cannot_create(AtomicDir::create(&file.join("out"), Existing::Replace), "file");
    assert_cannot_create(AtomicDir::create(&place.path().join(".."), Existing::Replace), "names no file or folder");
    assert_cannot_create(AtomicFile::create(Path::new("/"), Existing::Replace), "names no file or folder");
}
