//! `./x peers`: other implementations and guard4d's own rows in one run.

use std::ffi::OsString;
use std::fs;
use std::process::Command;

use clap::Args;
use serde_json::{Map, Value, json};

use crate::drivers::{Driver, Environment};
use crate::error::{Naming, Result};
use crate::pinned::{install_once, pip_install, python_environment};
use crate::process::{exit_code, run as run_program};
use crate::workspace::{Workspace, say};

/// Measure PyTorch, ncnn, other renderers of splats and marks of images beside guard4d; fetches them from PyPI
#[derive(Args)]
#[command(disable_help_flag = true)]
pub(crate) struct PeersArgs {
    /// Vulkan driver of guard4d's rows, in front of the other arguments; may be repeated, the first is the base
    #[arg(long = "driver", value_enum, value_name = "DRIVER")]
    drivers: Vec<Driver>,
    /// Arguments of benches/peers/peers.py
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

/// Exits with 0 where PyTorch finds CUDA.
const HAS_CUDA: &str = "import sys, torch; sys.exit(not torch.cuda.is_available())";

/// Installs the packages and fetches the drivers where they are missing, and measures.
pub(crate) fn run(workspace: &Workspace, args: &PeersArgs) -> Result<()> {
    workspace.need(&["compiler", "loader", "driver", "venv"])?;
    let mut drivers = Vec::new();
    for driver in &args.drivers {
        workspace.need(&[driver.wants()])?;
        drivers.extend(["--driver".into(), told(*driver, &driver.prepare(workspace)?)]);
    }
    let (folder, home) = (workspace.path("target/peers"), workspace.path("benches/peers"));
    let packages = home.join("requirements.txt");
    let list = fs::read_to_string(&packages).of_file(&packages)?;
    install_once(&folder, &list, || {
        say("installing what benches/peers/requirements.txt names");
        python_environment(&folder, true)?;
        pip_install(&folder, &packages)
    })?;
    let python = folder.join("bin/python");
    // What needs CUDA is of no use elsewhere.
    if exit_code(Command::new(&python).args(["-c", HAS_CUDA]))? == 0 {
        pip_install(&folder, &home.join("requirements-cuda.txt"))?;
    }
    let mut command = Command::new(&python);
    // It leaves nothing in the checkout.
    command.env("PYTHONDONTWRITEBYTECODE", "1").arg(home.join("peers.py"));
    run_program(command.args(drivers).args(&args.arguments))
}

/// A driver as peers.py takes it: its name, and what makes programs load it alone.
fn told(driver: Driver, environment: &Environment) -> String {
    let text = |value: &OsString| Value::from(value.to_string_lossy());
    let environment: Map<_, _> = environment.iter().map(|(name, value)| ((*name).to_owned(), text(value))).collect();
    json!({ "name": driver.name(), "environment": environment }).to_string()
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: PeersArgs,
    }

    fn parsed(line: &str) -> PeersArgs {
        Line::try_parse_from(std::iter::once("peers").chain(line.split_whitespace())).expect(line).args
    }

    #[test]
    fn drivers_stand_in_front_of_what_peers_py_takes() {
        for line in ["--out F --help", "-- --out F --help"] {
            let args = parsed(line);
            assert_eq!((args.drivers, args.arguments), (vec![], vec!["--out".into(), "F".into(), "--help".into()]));
            let args = parsed(&format!("--driver lavapipe --driver mesa-26 {line}"));
            assert_eq!(args.drivers, [Driver::Lavapipe, Driver::Mesa26], "{line}");
            assert_eq!(args.arguments, ["--out", "F", "--help"], "{line}");
        }
        assert_eq!(parsed("--driver system").arguments, [""; 0], "nothing is left over");
        assert!(Line::try_parse_from(["peers", "--driver"]).is_err(), "a driver is missing");
        assert!(Line::try_parse_from(["peers", "--driver", "mesa-24"]).is_err(), "no such driver");
    }

    #[test]
    fn a_driver_is_told_with_its_environment() {
        let told = told(Driver::Mesa25, &vec![("VK_DRIVER_FILES", "/a \"b\"".into())]);
        let read: Value = serde_json::from_str(&told).expect("JSON");
        assert_eq!(read, json!({ "name": "mesa-25", "environment": { "VK_DRIVER_FILES": "/a \"b\"" } }));
    }
}
