//! A disk that is full before all rows are done, and has room again later.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::figures::Figures;
use super::random::Random;
use super::running::check;
use super::site::{Ground, Site};
use super::trial::{Quiet, Tally, manifest};
use crate::error::{Error, Naming, Result};
use crate::process::exit_code;
use crate::workspace::say;

/// Disks that are full.
const RUNS: usize = 20;

/// Their size in KiB. The smallest holds the models and a few rows, the largest not all that the rows make.
const SMALLEST: f32 = 64.0;
const LARGEST: f32 = 256.0;

/// Room for everything.
const ROOMY: &str = "16m";

/// A small file system in memory, unmounted when this is dropped.
struct Disk(PathBuf);

impl Disk {
    fn mount(folder: PathBuf, size: &str) -> Result<Self> {
        let mut mount = Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"]).arg(&folder);
        match exit_code(&mut mount)? {
            0 => Ok(Self(folder)),
            _ => Err(Error::Missing("a full disk was not tried: mounting a tmpfs is not allowed here".to_owned())),
        }
    }

    fn resize(&self, size: &str) -> Result<()> {
        let code = exit_code(Command::new("mount").args(["-o", &format!("remount,size={size}")]).arg(&self.0))?;
        check(code == 0, || "the disk cannot be made larger".to_owned())
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        if !matches!(exit_code(Command::new("umount").arg(&self.0)), Ok(0)) {
            say(&format!("{} stays mounted", self.0.display()));
        }
    }
}

/// Runs the manifest on full disks, makes room, and goes on.
pub(super) fn run(ground: &Ground, quiet: &Quiet, figures: &mut Figures) -> Result<()> {
    say("farm: the disk is full");
    let (mut random, mut tally) = (Random::new(28), Tally::default());
    let (mut stopped, mut records_lost) = (0, 0);
    for _ in 0..RUNS {
        let size = format!("{}k", random.between(SMALLEST, LARGEST).round());
        let disk = Disk::mount(ground.folder()?, &size)?;
        let site = ground.site_in(disk.0.clone(), &manifest())?;
        let full = site.act("run", &[])?;
        check([3, 73, 74].contains(&full.code), || {
            format!("a disk of {size} is full: exit code {}\n{}", full.code, full.stderr)
        })?;
        tally.troubled += 1;
        stopped += usize::from(full.code != 3);
        records_lost += cut_off(&site.path("jobs.farm"))?;
        whole_or_not_there(&site, quiet, &size)?;
        disk.resize(ROOMY)?;
        tally.settle(&site, quiet, &["--retry-failed"])?;
    }
    tally.tell("full disk", figures);
    figures.add("full disk: runs that ended because a record found no room", stopped, "runs");
    figures.add("full disk: records cut off", records_lost, "records");
    Ok(())
}

/// An error unless each output is whole, or is not there.
fn whole_or_not_there(site: &Site<'_>, quiet: &Quiet, size: &str) -> Result<()> {
    for (name, bytes) in site.made()? {
        let is_whole = quiet.made.get(&name) == Some(&bytes);
        check(is_whole, || format!("a full disk of {size} holds out/{name}, which is not what a quiet run makes"))?;
    }
    Ok(())
}

/// How many files of records end in the middle of a line.
fn cut_off(folder: &Path) -> Result<usize> {
    let mut found = 0;
    for entry in fs::read_dir(folder).of_file(folder)? {
        let path = entry.of_file(folder)?.path();
        if path.extension().is_some_and(|end| end == "jsonl") {
            let bytes = fs::read(&path).of_file(&path)?;
            found += usize::from(bytes.last().is_some_and(|last| *last != b'\n'));
        }
    }
    Ok(found)
}
