//! The study's rows: what is measured stays, and is not measured again.

#[path = "../benches/study/ledger.rs"]
mod ledger;

use std::fs;
use std::path::PathBuf;

use ledger::Ledger;
use tempfile::TempDir;

fn columns() -> Vec<String> {
    words(&["model", "seed", "marked", "swap"])
}

fn words(cells: &[&str]) -> Vec<String> {
    cells.iter().map(|&c| c.to_owned()).collect()
}

fn file() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("deep/study.tsv");
    (folder, path)
}

fn id(model: &str, seed: &str) -> [(&'static str, String); 2] {
    [("model", model.to_owned()), ("seed", seed.to_owned())]
}

#[test]
fn rows_outlast_the_run_and_are_found_again() {
    let (_folder, path) = file();
    let mut ledger = Ledger::open(&path, columns()).expect("a new file");
    assert!(ledger.find(&id("robot", "0")).is_none(), "nothing is measured yet");
    ledger.append(words(&["robot", "0", "0.9", ""])).expect("writable");
    ledger.append(words(&["fox\tred", "1", "inf", ""])).expect("writable");
    drop(ledger);

    let mut ledger = Ledger::open(&path, columns()).expect("our own file");
    let row = ledger.find(&id("robot", "0")).expect("it was measured");
    assert_eq!(ledger.number(row, "marked"), Some(0.9));
    assert_eq!(ledger.number(row, "swap"), None, "an empty cell is no number");
    assert!(ledger.find(&id("fox red", "1")).is_some(), "a tab inside a cell makes no new cell");
    assert!(ledger.find(&id("robot", "1")).is_none(), "another seed");

    ledger.append(words(&["robot", "0", "0.8", "0.7"])).expect("writable");
    let row = ledger.find(&id("robot", "0")).expect("it was measured twice");
    assert_eq!(ledger.cell(row, "swap"), "0.7", "the newer row counts");
    let newest: Vec<_> = ledger.newest(&["model", "seed"]).iter().map(|row| ledger.cell(row, "marked")).collect();
    assert_eq!(newest, ["0.8", "inf"]);
}

#[test]
fn a_line_that_was_cut_off_is_dropped() {
    let (_folder, path) = file();
    let mut ledger = Ledger::open(&path, columns()).expect("a new file");
    ledger.append(words(&["robot", "0", "0.9", ""])).expect("writable");
    let whole = fs::read_to_string(&path).expect("readable");
    for cut in ["fox", "fox\t0\t0.5\t0.", &whole[..5]] {
        fs::write(&path, format!("{whole}{cut}")).expect("writable");
        let ledger = Ledger::open(&path, columns()).expect("the rest is whole");
        assert_eq!(ledger.newest(&["model"]).len(), 1, "after {cut:?}");
        assert_eq!(fs::read_to_string(&path).expect("readable"), whole, "after {cut:?}");
    }
    fs::write(&path, &whole[..5]).expect("writable");
    let ledger = Ledger::open(&path, columns()).expect("a head that was cut off");
    assert!(ledger.newest(&["model"]).is_empty(), "no row");
}

#[test]
fn a_file_with_other_columns_is_left_alone() {
    let (_folder, path) = file();
    Ledger::open(&path, columns()).expect("a new file");
    let mut more = columns();
    more.push("steps".to_owned());
    let refused = Ledger::open(&path, more).expect_err("other columns");
    assert_eq!(refused.exit_code(), 65, "{refused}");
    let whole = fs::read_to_string(&path).expect("readable");
    for other in [format!("{whole}robot\t0\n"), "notes".to_owned()] {
        fs::write(&path, &other).expect("writable");
        let refused = Ledger::open(&path, columns()).expect_err("a short row, another file");
        assert_eq!(refused.exit_code(), 65, "{refused}");
        assert_eq!(fs::read_to_string(&path).expect("readable"), other, "nothing is overwritten");
    }
}
