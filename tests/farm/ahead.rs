//! Inputs that are read ahead.

use std::fs;
use std::path::PathBuf;

use guard4d_engine::farm::ahead::Ahead;

#[test]
fn files_and_folders_are_read_and_what_is_not_there_is_left_to_its_row() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("model/below")).expect("writable");
    fs::write(at("model/below/a"), [1; 3000]).expect("writable");
    fs::write(at("model/b"), [2; 500]).expect("writable");
    fs::write(at("one.ply"), [3; 20]).expect("writable");
    let ahead = Ahead::default();
    for input in [at("model"), at("none.ply"), at("one.ply"), PathBuf::new()] {
        ahead.ask(&input);
    }
    assert_eq!(ahead.finish(), 3520, "bytes of all that is there");
}
