//! Ledgers: rows outlast a broken-off run.

use std::fs;
use std::path::PathBuf;

use guard4d_engine::base::ledger::Ledger;
use guard4d_engine::error::EngineError;
use serde::{Deserialize, Serialize};
use tempfile::TempDir;

/// A row as studies have them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Row {
    embedding: String,
    take: String,
    marked: Option<f64>,
    psnr_db: Option<f64>,
    error: String,
}

fn file() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("deep/readings.csv");
    (folder, path)
}

fn row(embedding: &str, marked: f64) -> Row {
    let psnr_db = Some(f64::INFINITY);
    Row { embedding: embedding.to_owned(), take: "plain".to_owned(), marked: Some(marked), psnr_db, ..Row::default() }
}

fn find<'a>(ledger: &'a Ledger<Row>, embedding: &str, take: &str) -> Option<&'a Row> {
    ledger.newest(|row| row.embedding == embedding && row.take == take)
}

#[test]
fn rows_outlast_the_run_and_the_newest_counts() {
    let (_folder, path) = file();
    let mut ledger = Ledger::open(&path).expect("a new file");
    assert!(find(&ledger, "a", "plain").is_none(), "nothing is measured yet");
    let odd = Row { error: "a, \"b\"\nc".to_owned(), ..row("b", 0.5) };
    ledger.append(vec![row("a", 0.5), odd.clone()]).expect("writable");
    ledger.append(vec![row("a", 0.75)]).expect("writable");
    drop(ledger);
    let ledger = Ledger::open(&path).expect("our own file");
    assert_eq!(ledger.rows(), [row("a", 0.5), odd.clone(), row("a", 0.75)], "all, in their order");
    assert_eq!(find(&ledger, "a", "plain"), Some(&row("a", 0.75)), "the newest");
    assert_eq!(find(&ledger, "b", "plain"), Some(&odd), "commas, quotes, line ends, infinite decibels");
    assert!(find(&ledger, "a", "8 frames").is_none(), "another film");
}

#[test]
fn a_line_that_was_cut_off_is_dropped_and_other_columns_are_refused() {
    let (_folder, path) = file();
    Ledger::open(&path).and_then(|mut ledger| ledger.append(vec![row("a", 0.5), row("b", 1.0)])).expect("writable");
    let text = fs::read_to_string(&path).expect("readable");
    fs::write(&path, &text[..text.len() - 5]).expect("writable");
    let mut ledger = Ledger::open(&path).expect("a cut-off line is no reason to lose the others");
    assert!(find(&ledger, "a", "plain").is_some() && find(&ledger, "b", "plain").is_none(), "whole lines stay");
    ledger.append(vec![row("c", 1.0)]).expect("writable");
    assert!(find(&Ledger::open(&path).expect("whole again"), "c", "plain").is_some(), "it goes on behind them");

    fs::write(&path, "model,bits\nrobot,many\n").expect("writable");
    let error = Ledger::<Row>::open(&path).expect_err("the columns of something else");
    assert!(matches!(&error, EngineError::BadData { path: named, .. } if *named == path), "{error}");
}
