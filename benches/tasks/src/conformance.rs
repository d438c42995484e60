//! `./x conformance`: the tests of what a device computes, on one driver.

use std::fmt::{self, Display};
use std::fs;
use std::time::Instant;

use clap::{Args, ValueEnum};

use crate::counts::{Counts, all_matched};
use crate::drivers::Driver;
use crate::error::{Error, Naming, Result};
use crate::process::{succeeded, tee};
use crate::workspace::{Workspace, say};

/// Tests that compare what a device computes with twins and with other implementations' numbers: kernels one by one,
/// whole pictures, the towers of the built-in CLIP (larger ones run the same kernels for much longer). The others test
/// the host, or how well a mark is read, in which no driver has a say.
pub(crate) const TESTS: [&str; 3] = ["kernels::", "render::", "::mini::"];

/// Which family of kernels a device runs.
#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
enum Kernels {
    /// What suits the device
    Auto,
    /// Those for processors
    Lanes,
    /// Those for GPUs
    Tiles,
}

impl Display for Kernels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::Lanes => "lanes",
            Self::Tiles => "tiles",
        })
    }
}

/// Run the tests of what a device computes on one driver, and count what passed, failed and was skipped
#[derive(Args)]
pub(crate) struct ConformanceArgs {
    /// The driver, which is fetched and never installed
    #[arg(long, value_enum, default_value_t = Driver::Lavapipe)]
    driver: Driver,
    /// The kernels that the device runs
    #[arg(long, value_enum, default_value_t = Kernels::Auto)]
    kernels: Kernels,
    /// Run the tests with these in their names, and what else the test program takes, instead of the usual ones
    #[arg(last = true)]
    tests: Vec<String>,
}

/// Runs the tests, prints what they print, and keeps it beside the drivers.
pub(crate) fn run(workspace: &Workspace, args: &ConformanceArgs) -> Result<()> {
    workspace.need(&["compiler", "loader", args.driver.wants(), "layers"])?;
    let environment = args.driver.prepare(workspace)?;
    let (driver, kernels) = (args.driver.name(), args.kernels);
    let log = workspace.path(&format!("target/drivers/{driver}-{kernels}.log"));
    let mut command = workspace.cargo_test();
    command.envs(environment).env("GUARD4D_REQUIRE_VULKAN", "1").env("GUARD4D_KERNELS", kernels.to_string()).arg("--");
    let filters = match &args.tests[..] {
        [] => TESTS.to_vec(),
        tests => tests.iter().map(String::as_str).collect(),
    };
    command.args(&filters);
    let started = Instant::now();
    let code = tee(&mut command, &log)?;
    let printed = String::from_utf8_lossy(&fs::read(&log).of_file(&log)?).into_owned();
    let counts = Counts::of(&printed);
    say(&format!(
        "{driver}, kernels {kernels}: {} passed, {} failed, {} skipped, {} s; {}",
        counts.passed,
        counts.failed(),
        counts.skipped,
        started.elapsed().as_secs(),
        log.display()
    ));
    if !counts.any() {
        return Err(Error::Missing("no test ran".to_owned()));
    }
    succeeded(code)?;
    // What is skipped, and other options, come last.
    let names: Vec<_> = filters.into_iter().take_while(|filter| !filter.starts_with("--")).collect();
    all_matched(&printed, &names)
}
