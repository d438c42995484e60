//! Helpers of the tests, themselves tested.
#![allow(dead_code, reason = "each helper serves some of the tests")]

pub(crate) mod authority;
pub(crate) mod camera_writers;
pub(crate) mod close;
pub(crate) mod fixture;
pub(crate) mod golden;
pub(crate) mod gpu;
pub(crate) mod gradcheck;
pub(crate) mod interop;
pub(crate) mod old_receipt;
pub(crate) mod owner;
pub(crate) mod poison;
pub(crate) mod pth_builder;
pub(crate) mod random;
pub(crate) mod random_lpips;
pub(crate) mod raster;
pub(crate) mod room;
pub(crate) mod tiny_clip;
pub(crate) mod trained;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

/// A file of the repository.
pub(crate) fn repo(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// All files below `folder`, relative to it, sorted. A folder that is gone is a failure, so that no check passes for
/// want of files.
pub(crate) fn files_below(folder: &Path) -> Vec<PathBuf> {
    let (mut found, mut folders) = (Vec::new(), vec![folder.to_path_buf()]);
    while let Some(current) = folders.pop() {
        let entries = fs::read_dir(&current).unwrap_or_else(|e| panic!("{}: {e}", current.display()));
        for entry in entries {
            let path = entry.expect("the folder can be listed").path();
            match path.is_dir() {
                true => folders.push(path),
                false => found.push(path.strip_prefix(folder).expect("it is below").to_path_buf()),
            }
        }
    }
    found.sort();
    found
}

/// Names in a folder, sorted.
pub(crate) fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("the folder can be listed");
    let mut names: Vec<_> = entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// A file of the test material beside the repository. `None`, with the reason printed, where the
/// material is absent; with `GUARD4D_REQUIRE_SHARED` set its absence fails the test.
pub(crate) fn shared(path: &str) -> Option<PathBuf> {
    let full = repo("../shared").join(path);
    if full.exists() {
        return Some(full);
    }
    assert!(std::env::var_os("GUARD4D_REQUIRE_SHARED").is_none(), "{} is missing", full.display());
    skipped(&format!("{} is not here", full.display()));
    None
}

/// Says that the running test did not run, or not to its end. Goes to the process's own standard error:
/// what a passing test prints with `eprintln!` is captured, and nobody would see it.
pub(crate) fn skipped(why: &str) {
    let thread = std::thread::current();
    let line = format!("SKIPPED {}: {why}\n", thread.name().unwrap_or("a test"));
    // A closed standard error is no reason to fail.
    let _ = std::io::stderr().write_all(line.as_bytes());
}

/// As [`skipped`], but a failure where a skip is none: in continuous integration and in `./x test`.
pub(crate) fn skipped_unless_required(why: &str) {
    let required = ["CI", "GUARD4D_REQUIRE_VULKAN"].into_iter().find(|name| std::env::var_os(name).is_some());
    assert!(required.is_none(), "{why}; {} is set, so nothing may be skipped", required.unwrap_or_default());
    skipped(why);
}

/// Whether ffmpeg is here; without it a test is skipped, in continuous integration it fails.
pub(crate) fn has_ffmpeg() -> bool {
    let found = std::process::Command::new("ffmpeg").arg("-version").output().is_ok_and(|out| out.status.success());
    assert!(found || std::env::var_os("CI").is_none(), "continuous integration needs ffmpeg");
    if !found {
        skipped("ffmpeg is not here");
    }
    found
}
