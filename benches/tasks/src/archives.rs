//! A tree of files as archives, the same bytes whenever and by whomever they are packed.

use std::fs::{self, File};
use std::path::Path;
use std::process::Command;

use crate::error::{Error, Naming, Result};
use crate::process::{output, pipe, run, run_aside};

/// What the Debian package says of itself.
pub(crate) struct About {
    /// Version of the program.
    pub(crate) version: String,
    /// What it cannot run without.
    pub(crate) depends: Vec<String>,
}

/// Packages that most users need, and how the field for them puts it.
pub(crate) const RECOMMENDED: [(&str, &str); 2] =
    [("mesa-vulkan-drivers", "mesa-vulkan-drivers | vulkan-icd"), ("ffmpeg", "ffmpeg")];

/// When the last commit was made, in seconds, unless `SOURCE_DATE_EPOCH` says otherwise: the time of all files.
pub(crate) fn epoch(root: &Path, set: Option<String>) -> Result<u64> {
    let told = match set {
        Some(set) => set,
        None => output(Command::new("git").arg("-C").arg(root).args(["log", "-1", "--format=%ct"]))?,
    };
    told.trim().parse().map_err(|_| Error::Missing(format!("SOURCE_DATE_EPOCH is no number of seconds: {told}")))
}

/// Gives everything below `tree` the same time, and rights that do not depend on who unpacked or wrote it.
fn settle(tree: &Path, epoch: u64) -> Result<()> {
    run(Command::new("chmod").args(["-R", "u=rwX,go=rX"]).arg(tree))?;
    let time = format!("@{epoch}");
    run(Command::new("find").arg(tree).args(["-exec", "touch", "-h", "-d", &time, "{}", "+"]))
}

/// Packs the folder `name` of `parent` into the file `to`.
pub(crate) fn tar(parent: &Path, name: &str, epoch: u64, to: &Path) -> Result<()> {
    settle(&parent.join(name), epoch)?;
    let mut pack = Command::new("tar");
    pack.args(["-c", "--format=gnu", "--sort=name", "--owner=0", "--group=0", "--numeric-owner", "-C"]);
    let file = File::create(to).of_file(to)?;
    pipe(pack.arg(parent).arg(name), Command::new("gzip").args(["-9", "-n"]).stdout(file))
}

/// Makes a Debian package of `tree`, which holds `usr`, as the file `to`.
///
/// By `dpkg-deb`, which every Debian has. `cargo-deb` would have to be built first, which takes minutes, as long as the
/// rest of the task together, and would find nothing to do but to pack: pages, completions and licences are made by
/// the program and from cargo's metadata, and the other archive holds the same tree.
pub(crate) fn deb(tree: &Path, about: &About, epoch: u64, to: &Path) -> Result<()> {
    let folder = tree.join("DEBIAN");
    fs::create_dir(&folder).of_file(&folder)?;
    let size = output(Command::new("du").args(["-k", "-s", "--apparent-size"]).arg(tree.join("usr")))?;
    let kibibytes = size.split_whitespace().next().unwrap_or_default();
    let list = "find usr -type f -print0 | LC_ALL=C sort -z | xargs -0 md5sum";
    let sums = output(Command::new("sh").args(["-c", list]).current_dir(tree))?;
    for (name, text) in [("control", control(about, kibibytes)), ("md5sums", sums)] {
        let path = folder.join(name);
        fs::write(&path, text).of_file(&path)?;
    }
    settle(tree, epoch)?;
    let mut pack = Command::new("dpkg-deb");
    // With more threads, xz cuts the data into blocks, and how many there are depends on the machine.
    pack.env("SOURCE_DATE_EPOCH", epoch.to_string()).env("DPKG_DEB_THREADS_MAX", "1");
    run_aside(pack.args(["--root-owner-group", "-Zxz", "--build"]).arg(tree).arg(to))
}

/// The package about itself.
fn control(about: &About, kibibytes: &str) -> String {
    format!(
        "\
Package: guard4d
Version: {}
Architecture: amd64
Maintainer: The guard4d authors
Installed-Size: {kibibytes}
Depends: {}
Recommends: {}
Section: graphics
Priority: optional
Description: owner's messages in Gaussian-splat scenes
 guard4d hides an owner's message in a static or moving Gaussian-splat scene
 and reads it back from ordinary video of that scene.
 .
 It computes on any Vulkan 1.2 device with a compute queue that has timestamps;
 without a graphics card that is lavapipe, of mesa-vulkan-drivers. ffmpeg reads
 and writes its films.
",
        about.version,
        about.depends.join(", "),
        RECOMMENDED.map(|(_, recommended)| recommended).join(", "),
    )
}

/// An error where two files differ.
pub(crate) fn same(a: &Path, b: &Path) -> Result<()> {
    let read = |path: &Path| fs::read(path).of_file(path);
    if read(a)? == read(b)? {
        return Ok(());
    }
    Err(Error::Differs(format!("the same tree was packed twice, and {} and {} differ", a.display(), b.display())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn archives_do_not_tell_when_and_by_whom() {
        let parent = tempfile::tempdir().expect("a folder");
        let mut packed = Vec::new();
        for (names, mask) in [(["b", "a"], "077"), (["a", "b"], "002")] {
            let tree = parent.path().join(mask).join("tree");
            fs::create_dir_all(&tree).expect("a folder");
            for name in names {
                let script = format!("umask {mask}; echo {name} >{name}; chmod u+x {name}");
                run(Command::new("sh").args(["-c", &script]).current_dir(&tree)).expect("a file");
            }
            let to = parent.path().join(format!("{mask}.tar.gz"));
            tar(&parent.path().join(mask), "tree", 86_400, &to).expect("packs");
            packed.push(to);
        }
        same(&packed[0], &packed[1]).expect("the same bytes");
        let mut list = Command::new("tar");
        let told = output(list.env("TZ", "UTC").args(["-t", "-v", "-f"]).arg(&packed[0])).expect("lists");
        let first = told.lines().nth(1).expect("a file");
        assert!(first.starts_with("-rwxr-xr-x 0/0") && first.ends_with("1970-01-02 00:00 tree/a"), "{told}");
        let other = parent.path().join("other");
        fs::write(&other, "").expect("a file");
        assert_eq!(same(&packed[0], &other).expect_err("they differ").exit_code(), 1);
    }

    #[test]
    fn the_time_can_be_set() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        assert_eq!(epoch(root, Some("7".to_owned())).expect("a number"), 7);
        assert_eq!(epoch(root, Some("noon".to_owned())).expect_err("no number").exit_code(), 69);
    }

    #[test]
    fn the_package_names_what_it_needs() {
        let depends = vec!["libc6 (>= 2.35)".to_owned(), "libvulkan1".to_owned()];
        let about = About { version: "1.2.3".to_owned(), depends };
        let text = control(&about, "42");
        for line in [
            "Version: 1.2.3",
            "Installed-Size: 42",
            "Depends: libc6 (>= 2.35), libvulkan1",
            "Recommends: mesa-vulkan-drivers | vulkan-icd, ffmpeg",
        ] {
            assert!(text.lines().any(|l| l == line), "{line} in {text}");
        }
        // A line of the long text begins with a blank, and an empty one holds a dot.
        assert!(text.split("Description").nth(1).is_some_and(|long| long.lines().skip(1).all(|l| l.starts_with(' '))));
    }
}
