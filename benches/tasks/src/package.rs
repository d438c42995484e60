//! `./x package`: guard4d as a Debian package and as an archive to unpack over a prefix.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use clap::Args;

use crate::archives::{About, deb, epoch, same, tar};
use crate::bare;
use crate::error::{Error, Naming, Result};
use crate::licences::third_party;
use crate::needed::dependencies;
use crate::process::{output, run as run_program, run_aside};
use crate::programs::{guard4d, strip};
use crate::workspace::{Workspace, empty_folder, say};

/// Pack guard4d as a Debian package and as a .tar.gz, with man pages, completions and licences
#[derive(Args)]
pub(crate) struct PackageArgs {
    /// Program to pack, instead of building one
    #[arg(long, value_name = "FILE")]
    program: Option<PathBuf>,
    /// Folder for the packages [default: target/package]
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Pack twice and compare; then install the package in a bare Debian and run the demonstration there: as root
    #[arg(long)]
    check: bool,
}

/// What the loader opens while the program runs; no header of the program tells of it.
const LOADER: &str = "libvulkan1";

/// Shells, what the program calls them, and where below the prefix they look for completions.
const COMPLETIONS: [(&str, &str); 3] = [
    ("bash", "share/bash-completion/completions/guard4d"),
    ("zsh", "share/zsh/site-functions/_guard4d"),
    ("fish", "share/fish/vendor_completions.d/guard4d.fish"),
];

/// Where zsh looks in a prefix, and where it looks for what Debian's packages bring.
const ZSH: [&str; 2] = ["share/zsh/site-functions", "share/zsh/vendor-completions"];

/// What the two archives have in common.
struct Source {
    program: PathBuf,
    licences: String,
    epoch: u64,
}

/// Packs, and checks what was packed if asked to.
pub(crate) fn run(workspace: &Workspace, args: &PackageArgs) -> Result<()> {
    if env::consts::ARCH != "x86_64" {
        return Err(Error::Missing("packages are made for x86-64 only".to_owned()));
    }
    workspace.need(&["binutils", "dpkg"])?;
    if args.check {
        workspace.need(&["debootstrap"])?;
        bare::may_be_made()?;
    }
    let program = match &args.program {
        Some(program) => program.clone(),
        None => guard4d(workspace)?,
    };
    let epoch = epoch(workspace.root(), env::var("SOURCE_DATE_EPOCH").ok())?;
    let source = Source { program, licences: third_party(workspace)?, epoch };
    let out = args.out.clone().unwrap_or_else(|| workspace.path("target/package"));
    fs::create_dir_all(&out).of_file(&out)?;
    let work = workspace.path("target/package-work");
    let packed = pack(workspace, &source, &work, &out)?;
    for path in &packed {
        let size = path.metadata().of_file(path)?.len();
        say(&format!("{}, {size} bytes", path.display()));
    }
    if args.check {
        say("packing again");
        let again = workspace.path("target/package-again");
        empty_folder(&again)?;
        for (one, other) in packed.iter().zip(pack(workspace, &source, &work, &again)?) {
            same(one, &other)?;
        }
        say("packing twice gives the same bytes");
        fs::remove_dir_all(&again).of_file(&again)?;
        bare::check(workspace, &packed)?;
    }
    fs::remove_dir_all(&work).of_file(&work)
}

/// Writes the Debian package and the other archive into `out`, and returns their paths. Works in `work`, which it
/// empties.
fn pack(workspace: &Workspace, source: &Source, work: &Path, out: &Path) -> Result<[PathBuf; 2]> {
    empty_folder(work)?;
    let prefix = work.join("prefix");
    let program = prefix.join("bin/guard4d");
    empty_folder(&prefix.join("bin"))?;
    strip(&source.program, &program)?;
    let version = version(&output(Command::new(&program).arg("--version"))?)?;
    lay_out(workspace, &prefix, &source.licences)?;

    let name = format!("guard4d-{version}-x86_64-linux");
    let archive = out.join(format!("{name}.tar.gz"));
    fs::rename(&prefix, work.join(&name)).of_file(&prefix)?;
    tar(work, &name, source.epoch, &archive)?;

    let tree = work.join("debian");
    fs::create_dir(&tree).of_file(&tree)?;
    fs::rename(work.join(&name), tree.join("usr")).of_file(&tree)?;
    let [from, to] = ZSH.map(|folder| tree.join("usr").join(folder));
    fs::rename(&from, to).of_file(&from)?;
    let mut depends = dependencies(&tree.join("usr/bin/guard4d"))?;
    depends.push(LOADER.to_owned());
    let package = out.join(format!("guard4d_{version}_amd64.deb"));
    deb(&tree, &About { version, depends }, source.epoch, &package)?;
    Ok([package, archive])
}

/// The version in what `guard4d --version` prints.
fn version(told: &str) -> Result<String> {
    let line = told.lines().next().unwrap_or_default();
    let version = line.strip_prefix("guard4d ").filter(|version| !version.is_empty());
    version.map(str::to_owned).ok_or_else(|| Error::Broken(format!("this is not guard4d, but calls itself: {line}")))
}

/// Puts what goes along with the program beside it.
fn lay_out(workspace: &Workspace, prefix: &Path, licences: &str) -> Result<()> {
    // Under its own name: a program's name stands in its pages.
    let program = prefix.join("bin/guard4d");
    let pages = prefix.join("share/man/man1");
    fs::create_dir_all(prefix.join("share/man")).of_file(prefix)?;
    run_aside(Command::new(&program).arg("man").arg(&pages))?;
    for page in fs::read_dir(&pages).of_file(&pages)? {
        compress(&page.of_file(&pages)?.path())?;
    }
    for (shell, file) in COMPLETIONS {
        write(&prefix.join(file), &output(Command::new(&program).args(["completions", shell]))?)?;
    }
    let about = prefix.join("share/doc/guard4d");
    let read = |name: &str| {
        let path = workspace.path(name);
        fs::read_to_string(&path).of_file(&path)
    };
    let mit = read("LICENSE-MIT")?;
    let holders = mit.lines().find(|line| line.starts_with("Copyright")).unwrap_or_default();
    write(&about.join("copyright"), &copyright(holders))?;
    write(&about.join("LICENSE-MIT"), &mit)?;
    write(&about.join("LICENSE-APACHE"), &read("LICENSE-APACHE")?)?;
    write(&about.join("built-in-data.md"), &read("engine/assets/README.md")?)?;
    let crates = about.join("licences-of-crates");
    write(&crates, licences)?;
    compress(&crates)
}

/// Who holds which rights, in short.
fn copyright(holders: &str) -> String {
    format!(
        "\
guard4d
{holders}

guard4d is free software under the MIT licence or the Apache License 2.0, as you
like: LICENSE-MIT and LICENSE-APACHE in this folder. On Debian the latter is also
/usr/share/common-licenses/Apache-2.0.

The program contains crates of others. licences-of-crates.gz in this folder names
them, their authors and their licences, with the texts that these ask for. It also
contains Rust's standard library, by the Rust project: MIT or Apache-2.0.

The program contains data: a small scene and the weights of a small CLIP.
built-in-data.md in this folder says where they come from and under which terms,
those of the pictures among them that the weights were trained on.
"
    )
}

fn write(path: &Path, text: &str) -> Result<()> {
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).of_file(parent)?;
    }
    fs::write(path, text).of_file(path)
}

/// Puts a compressed file, which holds neither a name nor a time, in a file's place.
fn compress(path: &Path) -> Result<()> {
    run_program(Command::new("gzip").args(["-9", "-n"]).arg(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_guard4d_is_packed() {
        assert_eq!(version("guard4d 1.2.3\n").expect("a version"), "1.2.3");
        for other in ["ls (GNU coreutils) 9.1\nguard4d 1\n", "guard4d \n", ""] {
            assert_eq!(version(other).expect_err(other).exit_code(), 1);
        }
    }

    #[test]
    fn what_goes_along_is_below_the_prefix() {
        assert!(COMPLETIONS.iter().all(|(_, file)| file.starts_with("share/")), "the archive fits any prefix");
        assert!(COMPLETIONS.iter().any(|(_, file)| file.starts_with(ZSH[0])), "the package moves this folder");
        assert!(copyright("Copyright (c) a").lines().all(|line| line.len() <= 84), "a terminal is wide enough");
    }
}
