//! Helpers of the tests, themselves tested.
#![allow(dead_code, reason = "each helper serves some of the tests")]

pub(crate) mod close;
pub(crate) mod golden;
pub(crate) mod gpu;
pub(crate) mod gradcheck;
pub(crate) mod owner;
pub(crate) mod pth_builder;
pub(crate) mod random;

use std::path::{Path, PathBuf};

/// A file of the repository.
pub(crate) fn repo(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// A file of the test material beside the repository. `None`, with the reason printed, where the
/// material is absent; with `GUARD4D_REQUIRE_SHARED` set its absence fails the test.
pub(crate) fn shared(path: &str) -> Option<PathBuf> {
    let full = repo("../shared").join(path);
    if full.exists() {
        return Some(full);
    }
    assert!(std::env::var_os("GUARD4D_REQUIRE_SHARED").is_none(), "{} is missing", full.display());
    eprintln!("SKIPPED: {} is not here", full.display());
    None
}
