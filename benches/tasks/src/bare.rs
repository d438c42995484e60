//! What was packed, installed in a bare Debian: a tree with nothing in it but the system's base.

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use serde_json::Value;

use crate::archives::RECOMMENDED;
use crate::debian::{index_targets, mirror};
use crate::error::{Error, Naming, Result};
use crate::pinned::install_once;
use crate::process::{exit_code, log, output, run, run_aside};
use crate::workspace::{Workspace, say};

/// Programs that read what the package brings for them.
const READERS: [&str; 4] = ["man-db", "bash-completion", "zsh", "fish"];

/// Where Debian's programs must find what the package brings: a shell each, and its words. Every line must succeed.
const FOUND: [[&str; 3]; 6] = [
    ["sh", "-ec", "man -w guard4d guard4d-embed guard4d-verify >/dev/null; man guard4d | grep -q completions"],
    ["bash", "-c", ". /usr/share/bash-completion/bash_completion; _completion_loader guard4d; complete -p guard4d"],
    ["zsh", "-fc", "autoload -Uz compinit; compinit -u; [[ $_comps[guard4d] == _guard4d ]]"],
    ["fish", "-c", "complete -C 'guard4d ver' | grep -q verify"],
    [
        "sh",
        "-ec",
        "cd /usr/share/doc/guard4d; grep -q MIT copyright; test -s LICENSE-MIT; test -s LICENSE-APACHE; \
         grep -q 'Terms of the training data' built-in-data.md; \
         zcat licences-of-crates.gz | grep -q 'Redistributions in binary form'",
    ],
    ["sh", "-ec", "dpkg --verify guard4d; test -z \"$(dpkg --verify guard4d)\""],
];

/// The exit code of guard4d where there is no device.
const NO_DEVICE: u8 = 69;

/// Whether this user may make such a tree.
pub(crate) fn may_be_made() -> Result<()> {
    if output(Command::new("id").arg("-u"))?.trim() == "0" {
        return Ok(());
    }
    Err(Error::Missing("--check installs packages in a folder, and only root may do that".to_owned()))
}

/// A bare Debian, removed when it is dropped, whatever happened in it.
struct Tree {
    root: PathBuf,
    /// Where packages are kept that were fetched for it.
    kept: PathBuf,
    /// What apt said last: hundreds of lines.
    log: PathBuf,
}

impl Tree {
    /// A tree of this machine's release, from a base that is fetched once.
    fn new(workspace: &Workspace) -> Result<Self> {
        let folder = workspace.path("target/package-check");
        let (base, root) = (folder.join("base"), folder.join("root"));
        fetch_base(&base)?;
        remove(&root)?;
        let tree = Self { root, kept: base.join("tree").join(DOWNLOADS), log: folder.join("apt.log") };
        run(Command::new("cp").args(["-a", "--reflink=auto"]).arg(base.join("tree")).arg(&tree.root))?;
        let names = Path::new("/etc/resolv.conf");
        fs::copy(names, tree.root.join("etc/resolv.conf")).of_file(names)?;
        Ok(tree)
    }

    /// A program of the tree, which sees nothing of this machine but its network and its processor. What is mounted for
    /// it is gone when it ends, however it ends.
    fn command(&self, program: &str) -> Command {
        let mut command = isolated();
        command.arg(format!("--root={}", self.root.display())).arg(program);
        command
    }

    fn apt(&self, arguments: &[&str]) -> Result<()> {
        let mut command = self.command("apt-get");
        // There is no terminal to give to dpkg.
        command.args(["-y", "--no-install-recommends", "-o", "Dpkg::Use-Pty=0"]).args(arguments);
        match log(&mut command, &self.log)? {
            0 => Ok(()),
            code => Err(unfit(code, &format!("apt-get {}; see {}", arguments.join(" "), self.log.display()))),
        }
    }

    /// Keeps what apt has fetched, for the next tree.
    fn keep_downloads(&self) -> Result<()> {
        let folder = self.root.join(DOWNLOADS);
        for entry in fs::read_dir(&folder).of_file(&folder)? {
            let path = entry.of_file(&folder)?.path();
            if let Some(name) = path.file_name().filter(|_| path.extension().is_some_and(|e| e == "deb")) {
                fs::rename(&path, self.kept.join(name)).of_file(&path)?;
            }
        }
        Ok(())
    }
}

impl Drop for Tree {
    fn drop(&mut self) {
        if let Err(error) = remove(&self.root) {
            say(&format!("the bare Debian is still there: {error}"));
        }
    }
}

/// Where apt keeps packages.
const DOWNLOADS: &str = "var/cache/apt/archives";

fn remove(folder: &Path) -> Result<()> {
    if folder.exists() { fs::remove_dir_all(folder).of_file(folder) } else { Ok(()) }
}

/// Runs a program with mounts and processes of its own.
fn isolated() -> Command {
    let mut command = Command::new("unshare");
    command.env_clear().env("PATH", "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin");
    command.env("HOME", "/root").env("LC_ALL", "C.UTF-8").env("DEBIAN_FRONTEND", "noninteractive");
    for proxy in ["http_proxy", "https_proxy", "no_proxy"] {
        if let Some(value) = env::var_os(proxy) {
            command.env(proxy, value);
        }
    }
    command.args(["--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]);
    command
}

/// Fetches the base of this machine's release from the mirror that its apt is configured with.
fn fetch_base(folder: &Path) -> Result<()> {
    let path = Path::new("/etc/os-release");
    let about = fs::read_to_string(path).of_file(path)?;
    let suite = codename(&about).ok_or_else(|| Error::Missing("this machine's release has no name".to_owned()))?;
    let targets = index_targets()?;
    let why = || Error::Missing(format!("this machine's apt has no source for {suite}"));
    let mirror = mirror(&targets, suite).ok_or_else(why)?;
    let components = components(&targets, suite);
    install_once(folder, &format!("{suite} {components} {mirror}\n"), || {
        say(&format!("fetching the base of {suite}"));
        let options = ["debootstrap", "--variant=minbase", "--force-check-gpg"];
        let components = format!("--components={components}");
        run_aside(isolated().args(options).args([&components, suite]).arg(folder.join("tree")).arg(mirror))
    })
}

/// The release's name in `/etc/os-release`.
fn codename(about: &str) -> Option<&str> {
    about.lines().find_map(|line| line.strip_prefix("VERSION_CODENAME="))
}

/// The components of a suite that the recommended packages are in: Ubuntu has ffmpeg in the second.
fn components(targets: &str, suite: &str) -> String {
    let has = |component: &&str| targets.lines().any(|line| line.starts_with(&format!("{suite} {component} ")));
    ["main", "universe"].into_iter().filter(has).collect::<Vec<_>>().join(",")
}

/// Installs the package in a bare Debian, and the other archive after it, and tries both.
pub(crate) fn check(workspace: &Workspace, [package, archive]: &[PathBuf; 2]) -> Result<()> {
    let tree = Tree::new(workspace)?;
    for (from, to) in [(package, "tmp/guard4d.deb"), (archive, "tmp/guard4d.tar.gz")] {
        fs::copy(from, tree.root.join(to)).of_file(from)?;
    }
    say("installing the package in a bare Debian");
    tree.apt(&["update"])?;
    tree.apt(&["install", "/tmp/guard4d.deb"])?;
    say("what it says without a driver:");
    let code = exit_code(tree.command("guard4d").arg("devices"))?;
    if code != NO_DEVICE {
        return Err(Error::Broken(format!("without a driver, devices has to end with {NO_DEVICE}; it was {code}")));
    }
    tree.apt(&[&["install"][..], &RECOMMENDED.map(|(name, _)| name), &READERS].concat())?;
    tree.keep_downloads()?;
    for [shell, option, script] in FOUND {
        succeeds(&mut tree.command(shell), &[option, script])?;
    }
    say("man pages, completions and licences are found");
    demonstrate(&tree)?;

    tree.apt(&["purge", "guard4d"])?;
    // The same file, not the same path: Debian has a link from /usr/local/man.
    let unpacked = "test ! -e /usr/share/doc/guard4d; test ! -e /usr/bin/guard4d; \
                    tar -xzf /tmp/guard4d.tar.gz -C /usr/local --strip-components=1; hash -r; guard4d --version; \
                    test \"$(man -w guard4d)\" -ef /usr/local/share/man/man1/guard4d.1.gz; guard4d devices";
    succeeds(&mut tree.command("sh"), &["-ec", unpacked])?;
    say("the archive was unpacked over /usr/local, and runs");
    Ok(())
}

fn succeeds(command: &mut Command, arguments: &[&str]) -> Result<()> {
    match exit_code(command.args(arguments))? {
        0 => Ok(()),
        code => Err(unfit(code, &arguments.join(" "))),
    }
}

fn unfit(code: u8, what: &str) -> Error {
    Error::Broken(format!("in the bare Debian, this ended with exit code {code}: {what}"))
}

/// Runs the demonstration, which must read the message that it wrote.
fn demonstrate(tree: &Tree) -> Result<()> {
    say("running the demonstration there: minutes");
    let started = Instant::now();
    let told = output(tree.command("guard4d").args(["demo", "--json", "--out", "/tmp/demo"]))?;
    let (right, bits) = read(&told).ok_or_else(|| Error::Broken(format!("the message was not read: {told}")))?;
    say(&format!("the message was read, {right} of {bits} bits, in {} s", started.elapsed().as_secs()));
    Ok(())
}

/// Bits that are right, and bits, of a verdict that says PRESENT.
fn read(told: &str) -> Option<(u64, u64)> {
    let told: Value = serde_json::from_str(told).ok()?;
    let evidence = &told["verification"]["evidence"];
    (evidence["verdict"] == "present").then_some(())?;
    Some((evidence["matches"].as_u64()?, evidence["num_bits"].as_u64()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_release_is_the_machines() {
        assert_eq!(codename("ID=debian\nVERSION_CODENAME=bookworm\n"), Some("bookworm"));
        let targets = "a main http://m/\na universe http://m/\na-updates main http://m/\nb main http://m/\n";
        assert_eq!(components(targets, "a"), "main,universe");
        assert_eq!(components(targets, "b"), "main");
    }

    #[test]
    fn a_message_is_read_if_the_verdict_says_so() {
        let told = |verdict: &str| {
            let evidence = serde_json::json!({ "verdict": verdict, "matches": 16, "num_bits": 16 });
            read(&serde_json::json!({ "verification": { "evidence": evidence } }).to_string())
        };
        assert_eq!(told("present"), Some((16, 16)));
        assert_eq!((told("inconclusive"), told("absent"), read("")), (None, None, None));
    }
}
