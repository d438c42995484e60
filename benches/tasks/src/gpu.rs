//! `./x gpu`: conformance and benchmarks of the device that guard4d takes by itself, or of `GUARD4D_DEVICE`.

use std::env;
use std::ffi::OsString;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use clap::Args;

use crate::conformance::TESTS;
use crate::counts::{Counts, all_matched, report};
use crate::error::{Error, Naming, Result};
use crate::process::{log, output, run as run_program, succeeded, tee};
use crate::programs::{executable, strip};
use crate::workspace::{Workspace, say};

/// On a machine with a GPU: conformance and benchmarks in one call, results under benches/results
#[derive(Args)]
pub(crate) struct GpuArgs {
    /// Only pack the programs into a file, for a machine that cannot build
    #[arg(long, value_name = "FILE", conflicts_with = "built")]
    build: Option<PathBuf>,
    /// Run the programs that another machine packed
    #[arg(long, value_name = "FILE")]
    built: Option<PathBuf>,
    /// Arguments of `./x bench`
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

/// What the archive holds: the programs, this one among them, and the folder that they were built in.
const PACKED: [&str; 4] = ["guard4d-tasks", "tests", "benches", "root.txt"];

/// Builds, packs, or runs.
pub(crate) fn run(workspace: &Workspace, args: &GpuArgs) -> Result<()> {
    let folder = workspace.path("target/gpu");
    fs::create_dir_all(&folder).of_file(&folder)?;
    if let Some(file) = &args.build {
        build(workspace, &folder)?;
        pack(&folder, file)?;
        let file = file.display();
        say(&format!("built {file}; take it along with this checkout and run  ./x gpu --built {file}"));
        return Ok(());
    }
    if let Some(file) = &args.built {
        run_program(Command::new("tar").arg("-xJf").arg(file).arg("-C").arg(&folder))?;
    } else {
        workspace.need(&["loader", "driver"])?;
        // Without layers less is seen, and it is said below.
        let _ = workspace.need(&["layers"]);
        build(workspace, &folder)?;
    }
    link_home(workspace, &folder)?;
    let layers = !workspace.lacks("layers")?;
    if !layers {
        say("no validation layers here: wrong results are seen, wrong use of Vulkan is not");
    }
    let program = |name: &str| {
        let mut command = Command::new(folder.join(name));
        if layers {
            command.env("GUARD4D_REQUIRE_VULKAN", "1");
        }
        command
    };
    let (tests, found) = conformance(&mut program("tests"), &folder.join("conformance.log"))?;
    let benches = benchmarks(&mut program("benches"), &args.arguments, &folder.join("benches.log"), &found)?;
    succeeded(if benches == 0 { tests } else { benches })
}

/// Builds what runs on the device, and leaves the names of machine and functions out.
fn build(workspace: &Workspace, folder: &Path) -> Result<()> {
    let message = ["--no-run", "--message-format", "json-render-diagnostics"];
    let tests = output(workspace.cargo_test().args(message))?;
    strip(&executable(&tests, "tests")?, &folder.join("tests"))?;
    let benches = output(workspace.cargo("bench").args(["--bench", "benches"]).args(message))?;
    strip(&executable(&benches, "benches")?, &folder.join("benches"))?;
    let this = env::current_exe().of_program("guard4d-tasks")?;
    if this != folder.join("guard4d-tasks") {
        strip(&this, &folder.join("guard4d-tasks"))?;
    }
    let home = folder.join("root.txt");
    fs::write(&home, format!("{}\n", workspace.root().display())).of_file(&home)
}

/// Tests and benchmarks hold the same weights, which a window this wide finds again: a third of the size.
fn pack(folder: &Path, file: &Path) -> Result<()> {
    let options = ["-c", "-I", "xz --lzma2=preset=6,dict=64MiB", "-f"];
    run_program(Command::new("tar").args(options).arg(file).arg("-C").arg(folder).args(PACKED))
}

/// The programs look for their files where they were built.
fn link_home(workspace: &Workspace, folder: &Path) -> Result<()> {
    let text = folder.join("root.txt");
    let home = PathBuf::from(fs::read_to_string(&text).of_file(&text)?.trim_end_matches('\n'));
    if !home.exists() {
        if let Some(parent) = home.parent() {
            fs::create_dir_all(parent).of_file(parent)?;
        }
        symlink(workspace.root(), &home).of_file(&home)?;
    }
    Ok(())
}

/// Runs the tests. Returns their exit code and what they printed.
fn conformance(tests: &mut Command, path: &Path) -> Result<(u8, String)> {
    say("conformance");
    let started = Instant::now();
    let code = log(tests.args(TESTS), path)?;
    let found = String::from_utf8_lossy(&fs::read(path).of_file(path)?).into_owned();
    let (counts, seconds) = (Counts::of(&found), started.elapsed().as_secs());
    let (passed, failed, skipped) = (counts.passed, counts.failed(), counts.skipped);
    say(&format!("passed, failed, skipped: {passed} {failed} {skipped}; {seconds} s"));
    let without: Vec<_> = found.lines().filter(|line| is_without_device(line)).collect();
    if !without.is_empty() {
        eprintln!("{}", without.join("\n"));
        return Err(Error::Missing("no device".to_owned()));
    }
    if code == 0 {
        all_matched(&found, &TESTS)?;
    }
    Ok((code, found))
}

fn is_without_device(line: &str) -> bool {
    line.split_once("SKIPPED ").is_some_and(|(_, why)| why.contains("no Vulkan device"))
}

/// Runs the benchmarks, and puts the page on conformance into their folder. Returns their exit code.
fn benchmarks(benches: &mut Command, arguments: &[OsString], path: &Path, found: &str) -> Result<u8> {
    say("benchmarks");
    let quiet = benches.env("VK_LOADER_LAYERS_DISABLE", "*validation*");
    let code = tee(quiet.arg("--bench").args(arguments), path)?;
    let printed = String::from_utf8_lossy(&fs::read(path).of_file(path)?).into_owned();
    if let Some(results) = results(&printed) {
        let page = Path::new(results).join("conformance.md");
        fs::write(&page, report(found)).of_file(&page)?;
        say(&page.display().to_string());
    }
    Ok(code)
}

/// The folder of results that the benchmarks name at last.
fn results(printed: &str) -> Option<&str> {
    printed.lines().filter_map(|line| line.strip_suffix("/summary.md")).next_back()
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: GpuArgs,
    }

    fn parsed(line: &str) -> GpuArgs {
        Line::try_parse_from(std::iter::once("gpu").chain(line.split_whitespace())).expect(line).args
    }

    #[test]
    fn arguments_of_the_benchmarks_pass_with_and_without_dashes() {
        for line in ["--full kernels", "-- --full kernels", "--built F --full kernels", "--built F -- --full kernels"] {
            let args = parsed(line);
            assert_eq!(args.arguments, ["--full", "kernels"], "{line}");
            assert_eq!(args.built.is_some(), line.contains("--built"), "{line}");
        }
        assert_eq!(parsed("--build F").build, Some("F".into()));
        assert!(Line::try_parse_from(["gpu", "--build"]).is_err(), "a file is missing");
        assert!(Line::try_parse_from(["gpu", "--build", "F", "--built", "F"]).is_err(), "one of both");
    }

    #[test]
    fn results_are_where_the_benchmarks_say() {
        assert_eq!(results("a row\n/r/2026-a/summary.md\nwritten\n"), Some("/r/2026-a"));
        assert_eq!(results("a row\n"), None);
        assert!(is_without_device("test a ... SKIPPED kernels::a: no Vulkan device: none"), "no device");
        assert!(!is_without_device("SKIPPED kernels::a: no layers"), "a device");
    }
}
