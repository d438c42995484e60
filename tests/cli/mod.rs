//! The program itself: exit codes, messages, what goes to stdout, and what is left on disk.

mod controls;
mod devices;
mod dump;
mod embed;
mod inputs;
mod keygen;
mod models;
mod outputs;
mod usage;
mod verify;

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use guard4d_kernels::vk::Assignment;
use tempfile::TempDir;

/// What a run of the program left.
struct Run {
    code: i32,
    stdout: String,
    stderr: String,
}

impl Run {
    fn of(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).expect("the program writes UTF-8");
        Self {
            code: output.status.code().expect("the program was not killed"),
            stdout: text(output.stdout),
            stderr: text(output.stderr),
        }
    }

    /// Fails unless the program ended with `code`, said all of `words` on stderr, and nothing on stdout.
    #[track_caller]
    fn refused(&self, code: i32, words: &[&str]) {
        assert_eq!(self.code, code, "exit code; stderr:\n{}", self.stderr);
        // Messages are folded to the terminal's width.
        let said: String =
            self.stderr.split_whitespace().filter(|w| !"│×╰─▶├".contains(w)).collect::<Vec<_>>().join(" ");
        for word in words {
            assert!(said.contains(word), "`{word}` is not in:\n{said}");
        }
        assert_eq!(self.stdout, "", "nothing on stdout");
    }

    /// Fails unless the program ended well.
    #[track_caller]
    fn done(&self) {
        assert_eq!(self.code, 0, "stderr:\n{}", self.stderr);
    }
}

/// Runs the program.
fn guard4d(args: &[&dyn AsRef<OsStr>]) -> Run {
    Run::of(command(args).output().expect("the program was built with the tests"))
}

/// The program, to be started.
fn command(args: &[&dyn AsRef<OsStr>]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_guard4d"));
    command.args(args.iter().map(|a| a.as_ref())).env_remove("RUST_LOG").env("NO_COLOR", "1");
    // What a scheduler says to the tests is not meant for the program under test.
    for name in Assignment::variables() {
        command.env_remove(name);
    }
    command
}

/// A folder for one test's outputs.
fn scratch() -> TempDir {
    tempfile::tempdir().expect("a temporary folder can be made")
}

/// Names in a folder, sorted.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("the folder can be listed");
    let mut names: Vec<_> = entries.map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// Writes `bytes` to a file of `folder`.
fn put(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().expect("the path has a folder")).expect("a temporary folder is writable");
    fs::write(&path, bytes).expect("a temporary folder is writable");
    path
}
