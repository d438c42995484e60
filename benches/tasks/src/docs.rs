//! `./x docs`: the pages as a book.

use std::fs;
use std::path::Path;
use std::process::Command;

use clap::Args;

use crate::book::assemble;
use crate::error::{Naming, Result};
use crate::pinned::install_once;
use crate::process::run as run_program;
use crate::workspace::{Workspace, say};

/// Build the pages as a book in target/book
#[derive(Args)]
pub(crate) struct DocsArgs {}

/// mdBook, and its version. It is not linked into guard4d.
const MDBOOK: [&str; 2] = ["mdbook", "0.5.4"];

/// Installs mdBook where it is missing, and builds the book.
pub(crate) fn run(workspace: &Workspace, _: &DocsArgs) -> Result<()> {
    let tools = workspace.path("target/docs-tools");
    let [name, version] = MDBOOK;
    install_once(&tools, &format!("{name} {version}\n"), || {
        say(&format!("installing {name} {version}"));
        run_program(&mut install(&tools))
    })?;
    assemble(workspace.root(), &workspace.path("target/book-source"))?;
    let book = workspace.path("target/book");
    if book.exists() {
        fs::remove_dir_all(&book).of_file(&book)?;
    }
    let mdbook = tools.join("bin").join(name);
    run_program(Command::new(mdbook).arg("build").arg(workspace.path("docs")).arg("--dest-dir").arg(&book))?;
    say(&book.join("index.html").display().to_string());
    Ok(())
}

/// Installs into `tools`. The book is small, so the program is built fast rather than to be fast.
fn install(tools: &Path) -> Command {
    let [name, version] = MDBOOK;
    let mut command = Command::new("cargo");
    command.args(["install", "--quiet", name, "--version", version, "--locked", "--debug"]);
    command.args(["--no-default-features", "--features", "search", "--root"]).arg(tools);
    command
}
