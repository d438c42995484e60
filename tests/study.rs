//! Studies: rows outlast a broken-off run, are not measured again, and become reports.

use std::fs;
use std::path::{Path, PathBuf};

use guard4d_engine::EngineError;
use guard4d_engine::clip::ClipSource;
use guard4d_engine::study::{Ledger, Row, Scale, Step, Study, Substudy};
use guard4d_kernels::{Device, DeviceOptions, DeviceSelect};
use tempfile::TempDir;

use crate::support::gpu::device;

fn file() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("deep/readings.csv");
    (folder, path)
}

fn row(embedding: &str, marked: f64) -> Row {
    let psnr_db = Some(f64::INFINITY);
    Row { embedding: embedding.to_owned(), take: "plain".to_owned(), marked: Some(marked), psnr_db, ..Row::default() }
}

#[test]
fn rows_outlast_the_run_and_the_newest_counts() {
    let (_folder, path) = file();
    let mut ledger = Ledger::open(&path).expect("a new file");
    assert!(ledger.find("a", "plain").is_none(), "nothing is measured yet");
    let odd = Row { error: "a, \"b\"\nc".to_owned(), ..row("b", 0.5) };
    ledger.append(vec![row("a", 0.5), odd.clone()]).expect("writable");
    ledger.append(vec![row("a", 0.75)]).expect("writable");
    drop(ledger);
    let ledger = Ledger::open(&path).expect("our own file");
    assert_eq!(ledger.find("a", "plain"), Some(&row("a", 0.75)), "the newest");
    assert_eq!(ledger.find("b", "plain"), Some(&odd), "commas, quotes, line ends, infinite decibels");
    assert!(ledger.find("a", "8 frames").is_none(), "another film");
}

#[test]
fn a_line_that_was_cut_off_is_dropped_and_other_columns_are_refused() {
    let (_folder, path) = file();
    Ledger::open(&path).and_then(|mut ledger| ledger.append(vec![row("a", 0.5), row("b", 1.0)])).expect("writable");
    let text = fs::read_to_string(&path).expect("readable");
    fs::write(&path, &text[..text.len() - 5]).expect("writable");
    let mut ledger = Ledger::open(&path).expect("a cut-off line is no reason to lose the others");
    assert!(ledger.find("a", "plain").is_some() && ledger.find("b", "plain").is_none(), "whole lines stay");
    ledger.append(vec![row("c", 1.0)]).expect("writable");
    assert!(Ledger::open(&path).expect("whole again").find("c", "plain").is_some(), "it goes on behind them");

    fs::write(&path, "model,bits\nrobot,many\n").expect("writable");
    let error = Ledger::open(&path).expect_err("the columns of something else");
    assert!(matches!(&error, EngineError::BadData { path: named, .. } if *named == path), "{error}");
}

/// The least that can be called an embedding.
fn tiny() -> Scale {
    Scale { size_px: 32, steps: Some(2), clips: Some(2), responses: Some(16), ..Scale::quick() }
}

/// Runs a sub-study and says which embeddings were made.
fn run(out: &Path, what: Substudy, most: usize) -> (Vec<String>, Result<Vec<PathBuf>, EngineError>) {
    let open = || Ok(Device::open_with(&DeviceSelect::Auto, DeviceOptions::default())?);
    let command = "a test".to_owned();
    let study = Study { scale: tiny(), clip: ClipSource::Mini, open: &open, out: out.to_owned(), command };
    let mut made = Vec::new();
    let done = study.run(&[what], &mut |step| {
        if let Step::Embedding { cell, .. } = step {
            if made.len() == most {
                return Err(EngineError::Stopped);
            }
            made.push(cell.arm.name.clone());
        }
        Ok(())
    });
    (made, done)
}

#[test]
fn a_study_goes_on_where_it_was_and_shares_what_another_one_measured() {
    if device().is_none() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (first, stopped) = run(folder.path(), Substudy::Table4, 1);
    assert!(matches!(stopped, Err(EngineError::Stopped)), "broken off: {stopped:?}");
    assert_eq!(first, ["no controls"], "one is done");
    let (rest, done) = run(folder.path(), Substudy::Table4, usize::MAX);
    assert_eq!(rest, ["noisy controls", "clean controls", "Guard4D, 16 bits"], "the others follow");
    let pages = done.expect("the study ends");
    assert_eq!(pages, [folder.path().join("table4.html")], "one page");

    let page = fs::read_to_string(&pages[0]).expect("a page");
    assert!(page.contains("<svg") && page.contains("97.86") && page.contains("noisy controls"), "chart, paper, arms");
    assert!(!page.contains("NaN"), "no figure is not a number");
    let json: serde_json::Value =
        serde_json::from_slice(&fs::read(folder.path().join("table4.json")).expect("a file")).expect("JSON");
    let readings = json["readings"].as_array().expect("a list");
    assert_eq!(readings.len(), 4, "one film each");
    for reading in readings {
        let marked = reading["marked"].as_f64().expect("a share");
        assert!((0.0..=1.0).contains(&marked) && reading["error"] == "", "{reading}");
    }
    let csv = fs::read_to_string(folder.path().join("table4.csv")).expect("a file");
    assert_eq!(csv.lines().count(), 5, "names and four rows: {csv}");
    assert!(csv.lines().nth(1).is_some_and(|line| line.starts_with("no controls,")), "arms come first");
    assert!(fs::metadata(folder.path().join("table4.svg")).is_ok_and(|m| m.len() > 0), "a picture");

    // The paper's method with all terms is in Table 3 as it is in Table 4.
    let (third, done) = run(folder.path(), Substudy::Table3, usize::MAX);
    done.expect("the study ends");
    let terms = ["without the message loss", "without the reconstruction loss", "without the offset penalty"];
    assert_eq!(third, terms, "what both need is made once; no control loss is no controls");
}

#[test]
fn what_cannot_be_done_is_a_row_that_says_why() {
    if device().is_none() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut scale = tiny();
    scale.size_px = 0;
    let open = || Ok(Device::open_with(&DeviceSelect::Auto, DeviceOptions::default())?);
    let (clip, out, command) = (ClipSource::Mini, folder.path().to_owned(), String::new());
    let study = Study { scale, clip, open: &open, out, command };
    study.run(&[Substudy::Fit], &mut |_| Ok(())).expect("a failure is a result");
    let csv = fs::read_to_string(folder.path().join("fit.csv")).expect("a file");
    assert_eq!(csv.lines().count(), 3, "two arms: {csv}");
    assert!(csv.lines().skip(1).all(|line| line.contains("image size")), "each says why: {csv}");
}

#[test]
fn scenes_of_one_name_are_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let demo = || "demo".parse().expect("the built-in scene");
    let scale = Scale { scenes: vec![demo(), demo()], ..tiny() };
    let open = || Ok(Device::open_with(&DeviceSelect::Auto, DeviceOptions::default())?);
    let (clip, out, command) = (ClipSource::Mini, folder.path().to_owned(), String::new());
    let study = Study { scale, clip, open: &open, out, command };
    let error = study.run(&[Substudy::Fit], &mut |_| Ok(())).expect_err("which is which?");
    assert!(matches!(error, EngineError::Usage { .. }), "{error}");
    assert!(fs::read_dir(folder.path()).expect("readable").next().is_none(), "nothing was written");
}
