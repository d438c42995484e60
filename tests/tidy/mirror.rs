//! A test stands where the thing that it tests stands.

use std::collections::BTreeSet;

use super::sources::{assert_none, files, name, root};

/// Folders of tests that mirror the folder behind them: rooms of the engine do by being rooms, `lab` is a crate.
const LAB: (&str, &str) = ("lab", "benches/lab/src");

/// Folders that mirror nothing here: kernels have a rule of their own, the program is tried from outside, and
/// `pipeline` holds what takes several rooms.
const FREE: [&str; 6] = ["cli", "fuzz", "kernels", "pipeline", "support", "tidy"];

/// What is wrong with the place of a test file, by its path below `tests`. `rooms` are the engine's, and `stands`
/// says whether a file or a folder of the repository is there.
fn misplaced(test: &str, rooms: &BTreeSet<String>, stands: impl Fn(&str) -> bool) -> Option<String> {
    let stem = test.strip_suffix(".rs").unwrap_or(test);
    let parts: Vec<&str> = stem.strip_suffix("/mod").unwrap_or(stem).split('/').collect();
    let [first, rest @ ..] = parts.as_slice() else { return None };
    if !test.contains('/') || FREE.contains(first) {
        return None;
    }
    let folder = match *first {
        room if rooms.contains(room) => format!("engine/src/{room}"),
        lab if lab == LAB.0 => LAB.1.to_owned(),
        _ => return Some(format!("tests/{test}: there is no room `{first}`")),
    };
    // Of all stems on the way each is a folder, but the last two may be a file: that which is tested, and, where its
    // tests are many, a folder of tests around it.
    let at = |n: usize| [&[folder.as_str()], &rest[..n]].concat().join("/");
    let is = |n: usize| stands(&at(n)) || stands(&format!("{}.rs", at(n)));
    let own = is(rest.len());
    let one_of_many = rest.len() > 1 && stands(&format!("{}.rs", at(rest.len() - 1)));
    (!own && !one_of_many).then(|| format!("tests/{test}: {}.rs is missing", at(rest.len())))
}

#[test]
fn tests_stand_where_their_subjects_stand() {
    let engine = files("engine/src", &["rs"]);
    let rooms: BTreeSet<_> = engine
        .iter()
        .filter_map(|path| Some(name(path).strip_prefix("engine/src/")?.split_once('/')?.0.to_owned()))
        .collect();
    assert!(rooms.contains("evidence"), "rooms are found: {rooms:?}");
    let tests = files("tests", &["rs"]);
    let stands = |path: &str| root().join(path).exists();
    let found: Vec<_> =
        tests.iter().filter_map(|path| misplaced(name(path).strip_prefix("tests/")?, &rooms, stands)).collect();
    assert_none("a test has the stem of what it tests", &found);
}

#[test]
fn misplaced_tests_are_told() {
    let rooms = BTreeSet::from(["media".to_owned()]);
    let there = ["engine/src/media", "engine/src/media/clip.rs", "engine/src/media/codec", "benches/lab/src/study"];
    let there = [&there[..], &["engine/src/media/codec/h264.rs", "benches/lab/src"]].concat();
    let check = |test: &str| misplaced(test, &rooms, |path| there.contains(&path));
    for test in [
        "main.rs",
        "media/mod.rs",
        "media/clip.rs",
        "media/codec.rs",
        "media/codec/mod.rs",
        "media/codec/h264.rs",
        "media/clip/mod.rs",
        "media/clip/damaged.rs",
        "lab/mod.rs",
        "lab/study.rs",
        "pipeline/delivery.rs",
        "kernels/nn/gelu.rs",
    ] {
        assert_eq!(check(test), None, "{test}");
    }
    for test in [
        "media/video.rs",
        "media/codec/other.rs",
        "media/clip/damaged/deep.rs",
        "attic/clip.rs",
        "lab/other.rs",
        "media/other/mod.rs",
        "media/other/clip.rs",
    ] {
        assert!(check(test).is_some(), "{test}");
    }
}
