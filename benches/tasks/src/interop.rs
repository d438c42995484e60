//! `./x interop`: other people's programs open what guard4d writes, and the other way round.

use std::fs;
use std::process::Command;

use clap::Args;

use crate::counts::all_matched;
use crate::error::{Error, Naming, Result};
use crate::pinned::{install_once, pip_install, python_environment};
use crate::process::{run_aside, succeeded, tee};
use crate::workspace::{Workspace, say};

/// Other people's programs open what guard4d writes, and the other way round; fetches them from npm and PyPI
#[derive(Args)]
pub(crate) struct InteropArgs {}

/// The tests that use them.
const TESTS: &str = "::interop::";

/// Installs the programs where they are missing, and runs the tests that use them.
pub(crate) fn run(workspace: &Workspace, _: &InteropArgs) -> Result<()> {
    workspace.need(&["compiler", "loader", "driver", "layers", "ffmpeg", "node", "npm", "venv", "chromium"])?;
    let folder = workspace.path("target/interop");
    let lists = ["package.json", "requirements.txt"].map(|name| workspace.path("tests/interop").join(name));
    let [npm_list, pip_list] = &lists;
    let mut list = String::new();
    for path in &lists {
        list += &fs::read_to_string(path).of_file(path)?;
    }
    let python = folder.join("python");
    install_once(&folder, &list, || {
        say("installing what tests/interop names");
        fs::copy(npm_list, folder.join("package.json")).of_file(npm_list)?;
        let options = ["--no-audit", "--no-fund", "--loglevel=error"];
        run_aside(Command::new("npm").args(["install", "--prefix"]).arg(&folder).args(options))?;
        python_environment(&python, false)?;
        pip_install(&python, pip_list)
    })?;
    let log = folder.join("tests.log");
    let mut command = workspace.cargo_test();
    command
        .env("GUARD4D_SPLAT_TRANSFORM", folder.join("node_modules/.bin/splat-transform"))
        .env("GUARD4D_NODE_MODULES", folder.join("node_modules"))
        .env("GUARD4D_CHROMIUM", "/usr/bin/chromium")
        .env("GUARD4D_INTEROP_PYTHON", python.join("bin/python"))
        .args(["--", TESTS]);
    let code = tee(&mut command, &log)?;
    let printed = String::from_utf8_lossy(&fs::read(&log).of_file(&log)?).into_owned();
    if printed.lines().any(|line| line.starts_with("SKIPPED")) {
        return Err(Error::Missing("a test was skipped".to_owned()));
    }
    succeeded(code)?;
    all_matched(&printed, &[TESTS])
}
