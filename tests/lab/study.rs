//! Studies: what was measured is not measured again, and becomes reports.

use std::fs;
use std::path::{Path, PathBuf};

use guard4d_engine::base::output::Existing;
use guard4d_engine::error::EngineError;
use guard4d_engine::networks::clip::{ClipModel, ClipSource};
use guard4d_engine::watermark::key::owner_key::digest_of;
use guard4d_kernels::{Device, DeviceOptions, DeviceSelect};
use guard4d_lab::study::{SUBSTUDIES, Scale, Step, Study, Substudy, redraw};

use crate::support::gpu::{Gpu, device};
use crate::support::owner::key_of;

/// The least that can be called an embedding.
fn tiny() -> Scale {
    Scale { size_px: 32, steps: Some(2), clips: Some(2), probes: Some(16), ..Scale::quick() }
}

fn part(name: &str) -> Substudy {
    SUBSTUDIES.into_iter().find(|part| part.name == name).expect("a sub-study")
}

#[test]
fn no_two_parts_share_a_name() {
    let names: Vec<_> = SUBSTUDIES.iter().map(|part| part.name).collect();
    for (i, name) in names.iter().enumerate() {
        assert!(!names[..i].contains(name), "`{name}` names one set of files");
    }
}

/// Puts keys that no minute of training went into where a study looks for those that it made before.
fn put_keys(gpu: &Gpu, out: &Path) {
    let clip = ClipModel::load(gpu, &ClipSource::Mini).expect("the embedded checkpoint is complete");
    let (folder, digits) = (out.join("keys"), digest_of(&clip).to_string());
    fs::create_dir_all(&folder).expect("writable");
    for seed in 0..2 {
        let path = folder.join(format!("{}-16-{seed}.key", &digits[..12]));
        key_of(&clip, [seed + 1; 32], 16).write(&path, Existing::Refuse).expect("writable");
    }
}

/// Runs a sub-study and says which embeddings were made.
fn run(out: &Path, what: &str, most: usize) -> (Vec<String>, Result<Vec<PathBuf>, EngineError>) {
    // Tests of embedding have validation layers watch what is done here over and over.
    let options = DeviceOptions { unwatched: true, ..DeviceOptions::default() };
    let open = || Ok(Device::open_with(&DeviceSelect::Auto, options)?);
    let command = "a test".to_owned();
    let study = Study { scale: tiny(), clip: ClipSource::Mini, open: &open, out: out.to_owned(), command };
    let mut made = Vec::new();
    let done = study.run(&[part(what)], &mut |step| {
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
    let Some(gpu) = device() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    put_keys(&gpu, folder.path());
    let (first, stopped) = run(folder.path(), "table4", 1);
    assert!(matches!(stopped, Err(EngineError::Stopped)), "broken off: {stopped:?}");
    assert_eq!(first, ["no controls"], "one is done");
    let (rest, done) = run(folder.path(), "table4", usize::MAX);
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

    // Nothing but the command that it tells differs in what is made of the rows alone.
    let again = folder.path().join("again");
    redraw(&part("table4"), &folder.path().join("table4.csv"), &again, "a test").expect("rows of this version");
    for name in ["table4.html", "table4.json", "table4.svg"] {
        let read = |folder: &Path| fs::read_to_string(folder.join(name)).expect("a file");
        assert!(read(&again) == read(folder.path()), "{name} is made again as it was");
    }
    let error =
        redraw(&part("fit"), &folder.path().join("fit.csv"), &again, "a test").expect_err("nothing was measured");
    assert!(matches!(error, EngineError::MissingInput { .. }), "{error}");

    // The paper's method with all terms is in Table 3 as it is in Table 4.
    let (third, done) = run(folder.path(), "table3", usize::MAX);
    done.expect("the study ends");
    let terms = ["without the message loss", "without the reconstruction loss", "without the offset penalty"];
    assert_eq!(third, terms, "what both need is made once; no control loss is no controls");
}

#[test]
fn what_cannot_be_done_is_a_row_that_says_why() {
    let Some(gpu) = device() else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    put_keys(&gpu, folder.path());
    let mut scale = tiny();
    scale.size_px = 0;
    let open = || Ok(Device::open_with(&DeviceSelect::Auto, DeviceOptions::default())?);
    let (clip, out, command) = (ClipSource::Mini, folder.path().to_owned(), String::new());
    let study = Study { scale, clip, open: &open, out, command };
    study.run(&[part("fit")], &mut |_| Ok(())).expect("a failure is a result");
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
    let error = study.run(&[part("fit")], &mut |_| Ok(())).expect_err("which is which?");
    assert!(matches!(error, EngineError::Usage { .. }), "{error}");
    assert!(fs::read_dir(folder.path()).expect("readable").next().is_none(), "nothing was written");
}
