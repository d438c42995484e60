//! Damaged files of every kind: what they are said to be is another matter, but no reader panics.
//!
//! `./x fuzz` looks for worse ones, for as long as one likes.

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;

use crate::support::random::Random;
use crate::support::{files_below, repo};

#[path = "fuzz/readers.rs"]
#[allow(unreachable_pub, reason = "the fuzz targets' library")]
mod readers;

use readers::READERS;

/// Places at which each file ends early.
const CUTS: usize = 24;
/// Files of which a few bytes are others.
const CHANGED: usize = 96;

fn corpus(name: &str) -> PathBuf {
    repo("tests/fuzz/corpus").join(name)
}

/// A file with some bytes changed, a part left out or a part twice.
fn changed(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut out = bytes.to_vec();
    for _ in 0..=random.below(4) {
        let at = random.below(out.len());
        // Sizes and counts are where most is at stake: all bits set, none, and anything.
        out[at] = [0xff, 0x00, 0x7f, random.below(256) as u8][random.below(4)];
    }
    let [from, to] = [random.below(out.len()), random.below(out.len())];
    let part = from.min(to)..from.max(to);
    match random.below(4) {
        0 => drop(out.drain(part)),
        1 => out.extend_from_within(part),
        _ => {}
    }
    out
}

#[test]
fn no_reader_panics_at_damaged_files() {
    for (name, reader) in READERS {
        let folder = corpus(name);
        let files = files_below(&folder);
        assert!(!files.is_empty(), "{name}: no files");
        for file in files {
            let bytes = fs::read(folder.join(&file)).expect("a file");
            let fed = |what: &str, bytes: &[u8]| {
                let done = catch_unwind(AssertUnwindSafe(|| reader(bytes)));
                assert!(done.is_ok(), "{name}: {}, {what}", file.display());
            };
            fed("as it is", &bytes);
            for cut in (0..CUTS).map(|part| part * bytes.len() / CUTS) {
                fed(&format!("its first {cut} bytes"), &bytes[..cut]);
            }
            for seed in 0..CHANGED as u64 {
                fed(&format!("changed by seed {seed}"), &changed(&bytes, &mut Random(seed)));
            }
        }
    }
}

#[test]
fn every_target_feeds_the_reader_of_its_name() {
    let targets = repo("tests/fuzz/fuzz_targets");
    let mut names: Vec<_> = files_below(&targets).iter().map(|file| file.with_extension("")).collect();
    names.sort();
    assert_eq!(names, READERS.map(|(name, _)| PathBuf::from(name)));
    for (name, _) in READERS {
        let source = fs::read_to_string(targets.join(name).with_extension("rs")).expect("a target");
        assert!(source.contains(&format!("guard4d_fuzz::{name}(data)")), "{name}: {source}");
    }
}
