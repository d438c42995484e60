//! Many jobs, one list: manifests, shares of them, claims, records, and a worker that does rows.

mod ahead;
mod claim;
mod contents;
mod forecast;
mod journal;
mod ledger;
mod manifest;
mod runner;
mod selection;
mod status;
mod submission;

use std::fs;
use std::path::PathBuf;

use guard4d_engine::farm::manifest::Manifest;
use tempfile::TempDir;

/// A manifest in a folder of its own.
pub(super) struct Farm {
    pub(super) folder: TempDir,
    pub(super) path: PathBuf,
}

impl Farm {
    /// Of these lines, as `jobs.csv` or, where they are objects, `jobs.jsonl`.
    pub(super) fn new(lines: &[&str]) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder can be made");
        let end = if lines.first().is_some_and(|line| line.starts_with('{')) { "jsonl" } else { "csv" };
        let path = folder.path().join(format!("jobs.{end}"));
        fs::write(&path, lines.join("\n")).expect("a temporary folder is writable");
        Self { folder, path }
    }

    pub(super) fn manifest(&self) -> Manifest {
        Manifest::open(&self.path).expect("the manifest is whole")
    }

    /// What opening it fails with.
    pub(super) fn error(&self) -> String {
        Manifest::open(&self.path).expect_err("the manifest is not whole").to_string()
    }

    pub(super) fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub(super) fn put(&self, name: &str, text: &str) {
        fs::write(self.at(name), text).expect("a temporary folder is writable");
    }
}
