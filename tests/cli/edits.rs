//! `guard4d verify --undo-guess`: films that were turned, cropped or mirrored as a whole.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::controls::{Film, Rigged};
use super::{guard4d, scratch};
use crate::support::gpu::device;

/// How far a film's logits are from zero: more than rounding anew does to them, less than other brightness or sides do.
const EDIT_MARGIN: f32 = 0.6;
/// The same for turned films: more than sampling pictures of 64 px twice does, less than turning does.
const TURN_MARGIN: f32 = 6.0;
const BITS: u64 = 16;

fn matches(report: &Value) -> u64 {
    report["clips"][0]["matches"].as_u64().expect("a count")
}

#[test]
fn what_was_done_to_a_film_is_found_undone_and_paid_for() {
    let Some(gpu) = device() else { return };
    let folder = scratch();
    let [edits, turns] = [EDIT_MARGIN, TURN_MARGIN]
        .map(|margin| Rigged::filmed(&gpu, "random", BITS as u32, Film { margin, size: "192x192" }));
    let edited = |rigged: &Rigged, chain: &str| -> PathBuf {
        let out = folder.path().join(chain);
        let suspect = rigged.file("suspect");
        let args: [&dyn AsRef<OsStr>; 6] = [&"attack", &suspect, &"--apply", &chain, &"--out", &out];
        guard4d(&args).done();
        out
    };
    let plain = edits.verify(0, &[]);
    let alone = plain["evidence"]["p_value"]["matches"].as_f64().expect("exact");
    assert!(plain["undone"].is_null() && matches(&plain) == BITS, "nothing is undone unless asked for: {plain}");
    let read = |rigged: &Rigged, film: &Path, more: &[&dyn AsRef<OsStr>]| -> Value {
        let run = rigged.verify_film(film, &rigged.file("owner.key"), &[more, &[&"--json"]].concat());
        assert!([0, 1, 4].contains(&run.code), "{}{}", run.stdout, run.stderr);
        serde_json::from_str(&run.stdout).expect("JSON on stdout")
    };
    for (chain, kinds, tried, edit) in [
        ("mirror", "mirror", 2, ("mirror", Value::from(true))),
        ("brightness:0.7", "brightness,mirror", 10, ("brightness", Value::from(0.7))),
        ("rotation:15", "rotation", 9, ("rotation", Value::from(15.0))),
        ("mirror,rotation:-20", "rotation,mirror", 18, ("rotation", Value::from(-20.0))),
    ] {
        let rigged = if chain.contains("rotation") { &turns } else { &edits };
        let film = edited(rigged, chain);
        let (as_it_is, undone) = (read(rigged, &film, &[]), read(rigged, &film, &[&"--undo-guess", &kinds]));
        // Turning 64 px there and back blurs away some of what so small a margin needs.
        let needed = if chain.contains("rotation") { matches(&as_it_is) + 1 } else { BITS };
        assert!(matches(&as_it_is) < needed && matches(&undone) >= needed, "{chain}: {as_it_is} {undone}");
        assert_eq!((&undone["undone"]["tried"], &undone["undone"][edit.0]), (&tried.into(), &edit.1), "{chain}");
        let p = &undone["evidence"]["p_value"];
        assert!(p["kind"] == "searched" && p["searched"] == tried, "{chain}: {p}");
        if needed == BITS {
            // Products of powers of two and a small whole number: exact.
            assert_eq!(p["matches"].as_f64(), Some(f64::from(tried) * alone), "{chain}: paid for");
            assert_eq!(undone["evidence"]["verdict"], "present", "{chain}");
        }
    }
    // This extractor remembers no views, so that nothing is framed and everything is worth a guess.
    let auto = read(&edits, &folder.path().join("mirror"), &[&"--undo-guess", &"auto"]);
    assert_eq!((&auto["undone"]["tried"], &auto["undone"]["mirror"]), (&90.into(), &Value::from(true)), "{auto}");
    let key = edits.file("owner.key");
    let words = edits.verify_film(&folder.path().join("mirror"), &key, &[&"--undo-guess", &"mirror"]).stdout;
    assert!(words.contains("mirrored; nearest to the claim of 2 guesses"), "{words}");
}

#[test]
fn ids_and_edits_are_both_searched() {
    let Some(gpu) = device() else { return };
    let rigged = Rigged::new(&gpu, "id:12:1234", 24);
    let plain = rigged.verify(0, &[&"--message", &"id:12"]);
    let report = rigged.verify(0, &[&"--message", &"id:12", &"--undo-guess", &"mirror"]);
    assert_eq!((&report["id"]["id"], &report["undone"]["mirror"]), (&1234.into(), &false.into()), "{report}");
    for (p, searched) in [(&plain, 4096), (&report, 8192)] {
        assert_eq!(p["evidence"]["p_value"]["searched"], searched, "{p}");
        assert_eq!(p["id"]["p_value"]["searched"], searched, "{p}");
    }
}

#[test]
fn edits_that_nobody_knows_are_refused() {
    let folder = scratch();
    let film = folder.path().join("film");
    for kinds in ["", "none", "rotation,jpeg", "crop:0.7"] {
        let args: [&dyn AsRef<OsStr>; 8] =
            [&"verify", &film, &"--key", &film, &"--receipt", &film, &"--undo-guess", &kinds];
        guard4d(&args).refused(2, &["--undo-guess", "rotation, crop, window, brightness, mirror"]);
    }
}
