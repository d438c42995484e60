//! What continuous integration must not leave out.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::{files_below, repo};

/// The commands of `.ci/run`: one per line, each a step whose time is told.
fn commands() -> Vec<String> {
    let script = fs::read_to_string(repo(".ci/run")).expect("a script");
    script.lines().filter_map(|line| line.strip_prefix("step ")).map(str::to_owned).collect()
}

/// The path of a test module, by its file below `tests/`.
fn module(file: &Path) -> String {
    let path = file.with_extension("").to_string_lossy().replace('/', "::");
    path.strip_suffix("::mod").unwrap_or(&path).to_owned()
}

/// Functions of a test file that need cooperative matrices, or do something else where there are some.
fn cooperative(source: &str) -> Vec<&str> {
    let (mut found, mut function) = (Vec::new(), "");
    for line in source.lines() {
        let start = line.strip_prefix("pub(crate) ").unwrap_or(line).strip_prefix("fn ");
        if let Some(name) = start.and_then(|start| start.split('(').next()) {
            function = name;
        }
        let asks = ["half_device()", "cooperation.is_some()"].iter().any(|mark| line.contains(mark));
        if asks && found.last() != Some(&function) {
            found.push(function);
        }
    }
    found
}

/// The functions among those of `files` that no filter of `command` has in its name.
fn left_out(command: &str, files: &[(PathBuf, String)]) -> Vec<String> {
    let filters: Vec<_> = command.split_once(" -- ").map_or("", |(_, filters)| filters).split(' ').collect();
    let names = files.iter().flat_map(|(file, source)| {
        let module = module(file);
        cooperative(source).into_iter().map(move |function| format!("{module}::{function}"))
    });
    names.filter(|name| !filters.iter().any(|filter| !filter.is_empty() && name.contains(filter))).collect()
}

#[test]
fn every_command_of_the_readme_and_the_book_is_run() {
    let (commands, readme) = (commands(), fs::read_to_string(repo("README.md")).expect("a page"));
    assert!(readme.lines().any(|line| line.starts_with("./x test")), "the README says how to test");
    for command in ["./x test", "./x lint", "./x docs", "./x bench --check"] {
        assert!(commands.iter().any(|line| line == command), "{command} in {commands:?}");
    }
}

/// Elsewhere they are skipped: no other driver has cooperative matrices.
#[test]
fn what_cooperative_matrices_compute_is_tested() {
    let commands = commands();
    let of_driver: Vec<_> = commands.iter().filter(|line| line.contains("--driver mesa-26")).collect();
    let [command] = of_driver[..] else { panic!("one command in {commands:?}") };
    let tests = files_below(&repo("tests")).into_iter().filter(|file| file.extension().is_some_and(|e| e == "rs"));
    let tests = tests.filter(|file| !file.starts_with("support") && file != Path::new("ci.rs"));
    let files: Vec<_> = tests
        .map(|file| {
            let source = fs::read_to_string(repo("tests").join(&file)).expect("a source");
            (file, source)
        })
        .collect();
    assert!(files.iter().any(|(_, source)| !cooperative(source).is_empty()), "some tests need them");
    let missing = left_out(command, &files);
    assert!(missing.is_empty(), "{command}\n  leaves out {}", missing.join(", "));
}

#[test]
fn tests_that_are_left_out_are_seen() {
    let source = "\
fn in_half() {
    let Some(gpu) = half_device() else { return };
    let Some(other) = half_device() else { return };
}

pub(crate) fn plain() {}

fn both() {
    if gpu.info().cooperation.is_some() {
    }
}
";
    assert_eq!(cooperative(source), ["in_half", "both"]);
    let files = [("a/b.rs".into(), source.to_owned()), ("a/mod.rs".into(), source.to_owned())];
    let run = |filters: &str| left_out(&format!("./x conformance --driver mesa-26{filters}"), &files);
    assert_eq!(run(" -- in_half a::b::both"), ["a::both"]);
    assert_eq!(run(" -- both half"), [""; 0], "all are run");
    assert_eq!(run("").len(), 4, "the usual tests are too many to rely on");
}
