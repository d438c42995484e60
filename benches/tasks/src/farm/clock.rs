//! Two machines of one farm, one of which has its clock ten minutes off.
//!
//! Files are stamped by the file server, so what can be wrong is a machine's own clock. libfaketime moves it for one
//! program and, told so, leaves the stamps of files alone: to that program, host and server disagree. Moving the
//! server's clock instead would look the same from there, and would need a server. The other machine is a host of
//! another name in a namespace of its own, so that a worker cannot look whether the other's process lives.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, SystemTime};

use super::figures::Figures;
use super::random::Random;
use super::running::{Running, check};
use super::site::{Ground, Site, json};
use super::trial::{Quiet, ROWS, Tally, manifest};
use crate::error::{Error, Naming, Result};
use crate::process::output;
use crate::workspace::say;

/// Pairs of machines.
const RUNS: usize = 20;

/// How far the clock of one is off, seconds.
const OFF: i64 = 600;

/// How old the signs of life of a killed worker are made: more than a worker may be silent.
const SILENT: Duration = Duration::from_secs(120);

/// How long a worker has for a manifest. One that waits in vain for a dead worker needs longer.
const LIMIT: Duration = Duration::from_secs(45);

/// Lets the loader list what it would load, as ldd(1) does.
const TRACE_LOADER: &str = "LD_TRACE_LOADED_OBJECTS";

/// Runs the manifest on two machines at once.
pub(super) fn run(ground: &Ground, quiet: &Quiet, figures: &mut Figures) -> Result<()> {
    say("farm: clocks are off");
    let library = library()?;
    clock_is_moved(&library)?;
    // What the loader would load for the program: a static one would keep its clock.
    let loaded = output(move_clock(&mut Command::new(ground.program()), &library, OFF).env(TRACE_LOADER, "1"))?;
    check(loaded.contains("libfaketime"), || "libfaketime cannot move the program's clock".to_owned())?;
    let (mut random, mut tally) = (Random::new(10), Tally::default());
    let mut killed = 0;
    for pair in 0..RUNS {
        let site = ground.site(&manifest())?;
        // A clock that is ahead sees silence where there is none, one that is behind does not see it where it is.
        let (is_ahead, offset) = if pair % 2 == 0 { (true, OFF) } else { (false, -OFF) };
        let other = ground.start(&mut elsewhere(&site))?;
        let mut off = site.command("run", &["--json"]);
        let wrong = ground.start(move_clock(&mut off, &library, offset))?;
        let mut done = 0;
        if is_ahead {
            done += done_by(other)?;
        } else {
            std::thread::sleep(random.moment(quiet.took / 2));
            killed += usize::from(other.kill()?);
            silence(&site.path("jobs.farm/claims"))?;
        }
        done += done_by(wrong)?;
        check(!is_ahead || done == ROWS as u64, || format!("two machines say that they did {done} of {ROWS} rows"))?;
        tally.troubled += 2;
        // Each machine clears away what its own killed workers left.
        ground.run(&mut elsewhere(&site))?.must_be(0, "the other machine's last run")?;
        tally.settle(&site, quiet, &[])?;
    }
    tally.tell("clock off", figures);
    figures.add("clock off: one of them killed at work", killed, "runs");
    Ok(())
}

fn done_by(worker: Running) -> Result<u64> {
    let ended = worker.ended(LIMIT)?.must_be(0, "one of two machines")?;
    Ok(json(&ended.stdout)?["done"].as_u64().unwrap_or(0))
}

/// `guard4d farm run` on a machine of another name.
fn elsewhere(site: &Site<'_>) -> Command {
    let mut command = Command::new("unshare");
    command.args(["--uts", "sh", "-c", "hostname elsewhere && exec \"$@\"", "sh"]).args(site.words("run", &["--json"]));
    command
}

/// Gives a program another time than files have.
fn move_clock<'a>(command: &'a mut Command, library: &Path, seconds: i64) -> &'a mut Command {
    command
        .env("LD_PRELOAD", library)
        .env("FAKETIME", format!("{seconds:+}s"))
        .env("NO_FAKE_STAT", "1")
        .env("FAKETIME_DONT_FAKE_MONOTONIC", "1")
}

/// Where Debian puts libfaketime's library for programs with threads.
fn library() -> Result<PathBuf> {
    let folder = Path::new("/usr/lib");
    let below = fs::read_dir(folder).of_file(folder)?.filter_map(|entry| Some(entry.ok()?.path()));
    let found = below.map(|path| path.join("faketime/libfaketimeMT.so.1")).find(|path| path.exists());
    found.ok_or_else(|| Error::Missing("libfaketime is missing".to_owned()))
}

/// An error unless the library moves a program's clock, and not the stamps of files.
fn clock_is_moved(library: &Path) -> Result<()> {
    let seconds = |command: &mut Command| -> Result<i64> {
        let printed = output(command)?;
        printed.trim().parse().map_err(|_| Error::Broken(format!("no number of seconds: {printed}")))
    };
    let date = |args: &[&str]| seconds(move_clock(Command::new("date").args(args), library, OFF));
    let stamp = |command: &mut Command| seconds(command.args(["-c", "%Y"]).arg(library));
    let now = seconds(Command::new("date").arg("+%s"))?;
    let moved = date(&["+%s"])? - now;
    check((OFF..OFF + 60).contains(&moved), || format!("libfaketime moved the clock by {moved} s, not {OFF}"))?;
    let stamps = [stamp(&mut Command::new("stat"))?, stamp(move_clock(&mut Command::new("stat"), library, OFF))?];
    check(stamps[0] == stamps[1], || "libfaketime moved the stamps of files".to_owned())
}

/// Makes the claims of a dead worker as old as after a long silence.
fn silence(claims: &Path) -> Result<()> {
    let of_other = |path: &PathBuf| fs::read_to_string(path).is_ok_and(|name| name.starts_with("elsewhere-"));
    if claims.is_dir() {
        for entry in fs::read_dir(claims).of_file(claims)? {
            let path = entry.of_file(claims)?.path();
            // Another worker may take it away meanwhile.
            if of_other(&path)
                && let Ok(file) = File::options().write(true).open(&path)
            {
                file.set_modified(SystemTime::now() - SILENT).of_file(&path)?;
            }
        }
    }
    Ok(())
}
