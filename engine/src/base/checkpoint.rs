//! Checkpoints of interrupted runs: where they stand, and how they go.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Where a run that writes `out` leaves its checkpoint: beside it, as `NAME.checkpoint.safetensors`.
#[must_use]
pub fn path_beside(out: &Path) -> PathBuf {
    let mut name = out.file_name().unwrap_or_default().to_owned();
    name.push(".checkpoint.safetensors");
    out.with_file_name(name)
}

/// Removes a finished run's checkpoint, which has no further use. One that cannot be removed does no harm, and is
/// told to the log.
pub fn remove(path: &Path) {
    if let Err(error) = fs::remove_file(path)
        && error.kind() != ErrorKind::NotFound
    {
        tracing::warn!("{}: {error}", path.display());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_stands_beside_its_output_and_goes() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = path_beside(&folder.path().join("deep.out"));
        assert_eq!(path, folder.path().join("deep.out.checkpoint.safetensors"), "the whole name is kept");
        fs::write(&path, b"").expect("writable");
        remove(&path);
        assert!(!path.exists(), "gone");
        remove(&path);
    }
}
