//! `./x peers`: other implementations and guard4d's own rows in one run.

use std::ffi::OsString;
use std::fs;
use std::process::Command;

use clap::Args;

use crate::error::{Naming, Result};
use crate::pinned::{install_once, pip_install, python_environment};
use crate::process::{exit_code, run as run_program};
use crate::workspace::{Workspace, say};

/// Measure PyTorch, ncnn and, with CUDA, gsplat beside guard4d's own kernels; fetches them from PyPI
#[derive(Args)]
#[command(disable_help_flag = true)]
pub(crate) struct PeersArgs {
    /// Arguments of benches/peers/peers.py
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<OsString>,
}

/// Exits with 0 where PyTorch finds CUDA.
const HAS_CUDA: &str = "import sys, torch; sys.exit(not torch.cuda.is_available())";

/// Installs the packages where they are missing, and measures.
pub(crate) fn run(workspace: &Workspace, args: &PeersArgs) -> Result<()> {
    workspace.need(&["compiler", "loader", "driver", "venv"])?;
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
    run_program(Command::new(&python).arg(home.join("peers.py")).args(&args.arguments))
}
