//! Other people's programs, which `./x interop` fetches.

use std::path::PathBuf;
use std::process::Command;

/// A program or folder that `./x interop` names in the environment. `None`, with the reason printed, where it does not.
pub(crate) fn program(variable: &str) -> Option<PathBuf> {
    let found = std::env::var_os(variable).map(PathBuf::from);
    if found.is_none() {
        println!("SKIPPED {variable} is not set; `./x interop` sets it");
    }
    found
}

/// What a program prints that has to end well.
#[track_caller]
pub(crate) fn run(command: &mut Command) -> String {
    let output = command.output().expect("it starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {said}");
    String::from_utf8(output.stdout).expect("text")
}
