//! Files of Debian packages, unpacked and never installed.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::{Error, Naming, Result};
use crate::process::{output, pipe, run_aside};
use crate::workspace::{empty_folder, say};

/// Keys of Debian's archive, by which apt checks what it fetches.
const KEYS: &str = "/usr/share/keyrings/debian-archive-keyring.gpg";

/// How long apt may take for one thing, s, and how often it is begun anew when that is over: apt waits as long as a
/// mirror sends anything at all.
const LIMIT_S: &str = "300";
const TRIES: usize = 3;
/// What `timeout` returns when it is over.
const OVER: u8 = 124;

/// An apt of its own, which knows some suites of Debian and no installed package. The packages come from the mirror
/// that this machine's apt is configured with; apt checks the archive's signature and the packages' hashes. The
/// machine's own lists and packages stay as they are.
pub(crate) struct Apt {
    folder: PathBuf,
}

/// A package and those of its files that are wanted.
pub(crate) struct Wanted {
    /// Name and suite: `NAME/SUITE`.
    pub(crate) package: &'static str,
    /// A pattern of tar's for their paths.
    pub(crate) files: &'static str,
}

impl Apt {
    /// An apt in `folder`, which it empties, for `suites`.
    pub(crate) fn new(folder: PathBuf, suites: &[&str]) -> Result<Self> {
        let Ok(targets) = index_targets() else {
            let why =
                "drivers come as Debian packages, and apt-get is missing; --driver system takes what is installed";
            return Err(Error::Missing(why.to_owned()));
        };
        let Some(mirror) = mirror(&targets, "bookworm") else {
            let why = "this machine's apt has no source for Debian bookworm; --driver system takes what is installed";
            return Err(Error::Missing(why.to_owned()));
        };
        let apt = Self { folder };
        empty_folder(&apt.folder)?;
        for inside in ["lists/partial", "cache/archives/partial"] {
            empty_folder(&apt.folder.join(inside))?;
        }
        for (name, text) in [("sources.list", sources(mirror, suites)), ("apt.conf", configuration(&apt.folder))] {
            let path = apt.folder.join(name);
            fs::write(&path, text).of_file(&path)?;
        }
        apt.get(&["update", "-q"], &apt.folder)?;
        Ok(apt)
    }

    /// Runs apt-get in a folder.
    fn get(&self, arguments: &[&str], folder: &Path) -> Result<()> {
        let mut tries = 0;
        loop {
            let mut command = Command::new("timeout");
            command.env("APT_CONFIG", self.folder.join("apt.conf")).current_dir(folder);
            let done = run_aside(command.args([LIMIT_S, "apt-get"]).args(arguments));
            tries += 1;
            if tries == TRIES || !matches!(done, Err(Error::Failed(OVER))) {
                return done;
            }
            say(&format!("apt-get stood still for {LIMIT_S} s, and is begun anew"));
        }
    }

    /// Unpacks files of a package into `into`, without their folders: drivers find each other there. Returns the
    /// package's file name, which holds its version.
    pub(crate) fn unpack_files(&self, wanted: &Wanted, into: &Path) -> Result<String> {
        say(&format!("unpacking {} of {}", wanted.files, wanted.package));
        let packages = self.folder.join("packages");
        empty_folder(&packages)?;
        self.get(&["download", "-q", wanted.package], &packages)?;
        let package = only(archives(&packages)?, wanted.package)?;
        let options = ["--wildcards", "--transform", "s,.*/,,", wanted.files];
        pipe(&mut open(&package), Command::new("tar").args(["-x", "-C"]).arg(into).args(options))?;
        Ok(file_name(&package))
    }

    /// Unpacks packages and all that they need, the C library too, into `into`. Returns the packages' file names.
    pub(crate) fn unpack_all(&self, packages: &[&str], into: &Path) -> Result<Vec<String>> {
        say(&format!("fetching {} and what they need", packages.join(" ")));
        let options = ["install", "-q", "-y", "--download-only", "--no-install-recommends"];
        self.get(&[&options[..], packages].concat(), &self.folder)?;
        let archives = archives(&self.folder.join("cache/archives"))?;
        for package in &archives {
            // Documents and translations are of no use here.
            let options = ["--exclude", "./usr/share/doc", "--exclude", "./usr/share/locale"];
            pipe(&mut open(package), Command::new("tar").args(["-x", "-C"]).arg(into).args(options))?;
        }
        Ok(archives.iter().map(|path| file_name(path)).collect())
    }

    /// Removes what apt needed.
    pub(crate) fn remove(self) -> Result<()> {
        fs::remove_dir_all(&self.folder).of_file(&self.folder)
    }
}

/// What this machine's apt fetches lists from: a suite, a component and a mirror in each line.
pub(crate) fn index_targets() -> Result<String> {
    let format = "$(RELEASE) $(COMPONENT) $(REPO_URI)";
    output(Command::new("apt-get").args(["indextargets", "--format", format, "Created-By: Packages"]))
}

/// The mirror of a suite in what `index_targets` returns.
pub(crate) fn mirror<'a>(targets: &'a str, suite: &str) -> Option<&'a str> {
    targets.lines().find_map(|line| line.strip_prefix(suite)?.strip_prefix(" main "))
}

fn sources(mirror: &str, suites: &[&str]) -> String {
    suites.iter().map(|suite| format!("deb [signed-by={KEYS}] {mirror} {suite} main\n")).collect()
}

fn configuration(folder: &Path) -> String {
    let apt = folder.display();
    format!(
        r#"Dir::State::lists "{apt}/lists";
Dir::State::status "/dev/null";
Dir::Cache "{apt}/cache";
Dir::Etc::sourcelist "{apt}/sources.list";
Dir::Etc::sourceparts "-";
APT::Sandbox::User "root";
Acquire::Languages "none";
"#
    )
}

/// The packages in a folder, sorted.
fn archives(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = fs::read_dir(folder).of_file(folder)?;
    let mut found: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    found.retain(|path| path.extension().is_some_and(|e| e == "deb"));
    found.sort();
    Ok(found)
}

fn only(mut archives: Vec<PathBuf>, package: &str) -> Result<PathBuf> {
    match (archives.pop(), archives.is_empty()) {
        (Some(archive), true) => Ok(archive),
        _ => Err(Error::Missing(format!("apt-get did not fetch {package}"))),
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Writes a package's files as an archive of tar.
fn open(package: &Path) -> Command {
    let mut command = Command::new("dpkg-deb");
    command.arg("--fsys-tarfile").arg(package);
    command
}

/// What the dynamic loader does not find for a library.
pub(crate) fn unmet(library: &Path, search: &OsStr) -> Result<Vec<String>> {
    let told = output(Command::new("ldd").arg(library).env("LD_LIBRARY_PATH", search))?;
    Ok(not_found(&told))
}

fn not_found(told: &str) -> Vec<String> {
    told.lines().filter_map(|line| Some(line.split_once(" => not found")?.0.trim().to_owned())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mirror_is_the_suites() {
        let targets = "bookworm-security main http://s/\nbookworm contrib http://c/\nbookworm main http://a/debian/\n\
                       bookworm main http://b/debian/\n";
        assert_eq!(mirror(targets, "bookworm"), Some("http://a/debian/"));
        assert_eq!(mirror("trixie main http://a/\n", "bookworm"), None);
        let list = sources("http://a/debian/", &["bookworm", "bookworm-backports"]);
        assert_eq!(list.lines().count(), 2);
        assert!(list.ends_with("gpg] http://a/debian/ bookworm-backports main\n"), "{list}");
    }

    #[test]
    fn apt_keeps_to_its_folder() {
        let text = configuration(Path::new("/a b/apt"));
        for line in ["Dir::State::lists \"/a b/apt/lists\";", "Dir::State::status \"/dev/null\";"] {
            assert!(text.lines().any(|l| l == line), "{line} in {text}");
        }
    }

    #[test]
    fn one_package_is_fetched_by_its_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let found = || only(archives(folder.path()).expect("a folder"), "a/bookworm").map(|path| file_name(&path));
        assert!(found().expect_err("nothing was fetched").to_string().contains("a/bookworm"));
        for name in ["a_1.0-2_amd64.deb", "notes.txt"] {
            fs::write(folder.path().join(name), "").expect("a file");
        }
        assert_eq!(found().expect("one package"), "a_1.0-2_amd64.deb");
    }

    #[test]
    fn missing_libraries_are_named() {
        let told = "\tlinux-vdso.so.1 (0x0)\n\tlibdrm.so.2 => not found\n\tlibz.so.1 => /lib/libz.so.1 (0x0)\n\
                    \tlibLLVM.so => not found\n";
        assert_eq!(not_found(told), ["libdrm.so.2", "libLLVM.so"]);
    }
}
