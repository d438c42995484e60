//! `./x fuzz`: changed files for every reader. Builds with libFuzzer's instrumentation, which stable compilers have
//! too, and without sanitizers, which they have not.

use std::fs;
use std::path::Path;
use std::process::Command;

use clap::Args;

use crate::error::{Error, Naming, Result};
use crate::process::{log, output, run as run_program, succeeded};
use crate::workspace::{Workspace, say};

/// Feed changed files to every reader, beginning with those of tests/fuzz/corpus
#[derive(Args)]
pub(crate) struct FuzzArgs {
    /// How long each reader is fed, in seconds
    #[arg(long, value_name = "N", default_value_t = 20)]
    seconds: u32,
    /// Names of files in tests/fuzz/fuzz_targets; all of them unless named
    #[arg(value_name = "TARGET")]
    targets: Vec<String>,
}

/// What libFuzzer needs of the compiler.
const RUSTFLAGS: &str = "--cfg fuzzing -Cdebug-assertions -Ccodegen-units=1 -Cpasses=sancov-module \
    -Cllvm-args=-sanitizer-coverage-level=4 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters \
    -Cllvm-args=-sanitizer-coverage-pc-table -Cllvm-args=-sanitizer-coverage-trace-compares";

/// A file of 64 KiB may take four times its size and 64 MiB; the rest is the program and libFuzzer's own.
const LIMITS: [&str; 4] = ["-max_len=65536", "-timeout=10", "-malloc_limit_mb=64", "-rss_limit_mb=512"];

/// Lines of a failed target's log that are shown.
const SHOWN: usize = 30;

/// Builds the targets and feeds one after the other.
pub(crate) fn run(workspace: &Workspace, args: &FuzzArgs) -> Result<()> {
    let home = workspace.path("tests/fuzz");
    let targets = if args.targets.is_empty() { all_targets(&home.join("fuzz_targets"))? } else { args.targets.clone() };
    let about = output(Command::new("rustc").arg("-vV"))?;
    let host = host(&about).ok_or_else(|| Error::Missing("rustc names no host".to_owned()))?;
    let mut build = Command::new("cargo");
    build.env("RUSTFLAGS", RUSTFLAGS).args(["build", "--quiet", "--locked", "--target", host]);
    build.arg("--manifest-path").arg(home.join("Cargo.toml")).arg("--target-dir").arg(workspace.path("target"));
    run_program(&mut build)?;
    let programs = workspace.path(&format!("target/{host}/debug"));
    for target in &targets {
        feed(workspace, &programs.join(target), target, args.seconds)?;
    }
    Ok(())
}

/// Feeds the reader that `program` tests.
fn feed(workspace: &Workspace, program: &Path, target: &str, seconds: u32) -> Result<()> {
    let folder = workspace.path("target/fuzz");
    let (corpus, artifacts) = (folder.join("corpus").join(target), folder.join("artifacts").join(target));
    for made in [&corpus, &artifacts] {
        fs::create_dir_all(made).of_file(made)?;
    }
    let path = folder.join(format!("{target}.log"));
    let mut command = Command::new(program);
    command.arg(format!("-max_total_time={seconds}")).args(LIMITS).arg("-print_final_stats=1");
    command.arg(format!("-artifact_prefix={}/", artifacts.display()));
    command.arg(&corpus).arg(workspace.path("tests/fuzz/corpus").join(target));
    let code = log(&mut command, &path)?;
    let printed = String::from_utf8_lossy(&fs::read(&path).of_file(&path)?).into_owned();
    let [inputs, memory] = ["number_of_executed_units", "peak_rss_mb"].map(|name| statistic(&printed, name));
    say(&format!("{target}: {inputs} inputs, at most {memory} MiB; {}", path.display()));
    if code != 0 {
        let lines: Vec<_> = printed.lines().collect();
        eprintln!("{}", lines[lines.len().saturating_sub(SHOWN)..].join("\n"));
    }
    succeeded(code)
}

/// The names of all targets, sorted.
fn all_targets(folder: &Path) -> Result<Vec<String>> {
    let entries = fs::read_dir(folder).of_file(folder)?;
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let mut targets: Vec<_> = names.filter_map(|name| Some(name.strip_suffix(".rs")?.to_owned())).collect();
    targets.sort();
    Ok(targets)
}

/// The host in what `rustc -vV` prints.
fn host(about: &str) -> Option<&str> {
    about.lines().find_map(|line| line.strip_prefix("host: "))
}

/// One of libFuzzer's final statistics; empty where it ended before.
fn statistic<'a>(printed: &'a str, name: &str) -> &'a str {
    let values = printed.lines().filter_map(|line| line.strip_prefix("stat::")?.strip_prefix(name)?.strip_prefix(':'));
    values.map(str::trim).next_back().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_are_read_from_the_log() {
        let printed = "#2\tINITED\nstat::number_of_executed_units: 1234\nstat::peak_rss_mb:               57\n";
        assert_eq!(statistic(printed, "number_of_executed_units"), "1234");
        assert_eq!(statistic(printed, "peak_rss_mb"), "57");
        assert_eq!(statistic("it crashed\n", "peak_rss_mb"), "");
    }

    #[test]
    fn every_target_is_one_of_the_manifest() {
        let home = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz");
        let manifest = fs::read_to_string(home.join("Cargo.toml")).expect("a manifest");
        let targets = all_targets(&home.join("fuzz_targets")).expect("a folder");
        assert!(!targets.is_empty(), "there are targets");
        for target in targets {
            assert!(manifest.contains(&format!("name = \"{target}\"")), "{target} is built");
            assert!(home.join("corpus").join(&target).is_dir(), "{target} has a corpus");
        }
    }

    #[test]
    fn rustc_names_the_host() {
        assert_eq!(
            host("rustc 1.95.0\nbinary: rustc\nhost: x86_64-unknown-linux-gnu\n"),
            Some("x86_64-unknown-linux-gnu")
        );
        assert_eq!(host("rustc 1.95.0\n"), None);
    }
}
