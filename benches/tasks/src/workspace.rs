//! The checkout that tasks work in, and what they share.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::{Naming, Result};
use crate::process::{output, run};

/// Cargo profile of the tests; `[profile.dev]` is already optimised enough for the twins.
const TEST_PROFILE: &str = "dev";

/// Tells the user something, as the entry script does.
pub(crate) fn say(text: &str) {
    eprintln!("x: {text}");
}

/// Makes an empty folder, whatever was there before.
pub(crate) fn empty_folder(path: &Path) -> Result<()> {
    if path.exists() {
        fs::remove_dir_all(path).of_file(path)?;
    }
    fs::create_dir_all(path).of_file(path)
}

/// The checkout.
pub(crate) struct Workspace {
    root: PathBuf,
}

impl Workspace {
    /// The checkout at `root`.
    pub(crate) fn new(root: PathBuf) -> Self {
        Self { root }
    }

    /// Its folder.
    pub(crate) fn root(&self) -> &Path {
        &self.root
    }

    /// A file or folder of it.
    pub(crate) fn path(&self, inside: &str) -> PathBuf {
        self.root.join(inside)
    }

    /// Cargo's command `name` for it.
    pub(crate) fn cargo(&self, name: &str) -> Command {
        let mut command = Command::new("cargo");
        command.arg(name).arg("--manifest-path").arg(self.path("Cargo.toml"));
        command
    }

    /// `cargo test` for the binary that holds all integration tests.
    pub(crate) fn cargo_test(&self) -> Command {
        let mut command = self.cargo("test");
        command.args(["--profile", TEST_PROFILE, "--test", "tests"]);
        command
    }

    /// Makes sure that the machine has what the entry script knows by these names.
    pub(crate) fn need(&self, wants: &[&str]) -> Result<()> {
        run(Command::new(self.path("x")).arg("need").args(wants))
    }

    /// Whether the machine lacks what the entry script knows by this name.
    pub(crate) fn lacks(&self, want: &str) -> Result<bool> {
        Ok(!output(Command::new(self.path("x")).args(["missing", want]))?.trim().is_empty())
    }
}
