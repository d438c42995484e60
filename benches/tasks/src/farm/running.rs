//! Programs that run beside this one, and are stopped when nobody waits for them any more.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::error::{Error, Naming, Result};
use crate::process::{code, exit_code};

/// How often something is looked at that is waited for.
const GLANCE: Duration = Duration::from_millis(20);

/// How long a program has to end after it was asked to.
const GRACE: Duration = Duration::from_secs(10);

/// Lines of a failed program's talk that are shown.
const SHOWN: usize = 20;

/// A program that runs, with what it prints in files.
pub(super) struct Running {
    child: Child,
    name: String,
    stdout: PathBuf,
    stderr: PathBuf,
}

/// What a program left.
pub(super) struct Ended {
    /// As shells tell it.
    pub(super) code: u8,
    pub(super) stdout: String,
    pub(super) stderr: String,
}

impl Running {
    /// Starts a program; `log` is where its two outputs go, with an ending for each.
    pub(super) fn start(command: &mut Command, log: &Path) -> Result<Self> {
        let (stdout, stderr) = (log.with_extension("out"), log.with_extension("err"));
        let name = command.get_program().to_string_lossy().into_owned();
        let out = File::create(&stdout).of_file(&stdout)?;
        let err = File::create(&stderr).of_file(&stderr)?;
        let child = command.stdin(Stdio::null()).stdout(out).stderr(err).spawn().of_program(&name)?;
        Ok(Self { child, name, stdout, stderr })
    }

    /// Its process.
    pub(super) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Whether it has ended.
    pub(super) fn is_over(&mut self) -> Result<bool> {
        Ok(self.child.try_wait().of_program(&self.name)?.is_some())
    }

    /// Kills it; whether it was still there.
    pub(super) fn kill(mut self) -> Result<bool> {
        let is_there = !self.is_over()?;
        self.child.kill().of_program(&self.name)?;
        self.child.wait().of_program(&self.name)?;
        Ok(is_there)
    }

    /// Waits for its end.
    pub(super) fn ended(mut self, limit: Duration) -> Result<Ended> {
        wait_until(&format!("{} ends", self.name), limit, || self.is_over())?;
        let status = self.child.wait().of_program(&self.name)?;
        let read = |path: &Path| fs::read(path).of_file(path).map(|b| String::from_utf8_lossy(&b).into_owned());
        Ok(Ended { code: code(status), stdout: read(&self.stdout)?, stderr: read(&self.stderr)? })
    }

    /// Asks it to end, and waits until it has.
    fn ask(&mut self) -> Result<()> {
        if self.is_over()? {
            return Ok(());
        }
        exit_code(Command::new("kill").arg("-TERM").arg(self.id().to_string()))?;
        let name = self.name.clone();
        wait_until(&format!("{name} ends"), GRACE, || self.is_over())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // What does not listen is killed; one that has ended is neither.
        if self.ask().is_err() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

impl Ended {
    /// An error unless it ended with this exit code.
    pub(super) fn must_be(self, code: u8, what: &str) -> Result<Self> {
        if self.code == code {
            return Ok(self);
        }
        let lines: Vec<&str> = self.stdout.lines().chain(self.stderr.lines()).collect();
        let shown = lines[lines.len().saturating_sub(SHOWN)..].join("\n");
        Err(Error::Broken(format!("{what}: exit code {}, not {code}\n{shown}", self.code)))
    }
}

/// Looks again and again until something is so.
pub(super) fn wait_until(what: &str, limit: Duration, mut is_so: impl FnMut() -> Result<bool>) -> Result<()> {
    let begun = Instant::now();
    while !is_so()? {
        if begun.elapsed() > limit {
            return Err(Error::Broken(format!("waited {} s until {what}", limit.as_secs())));
        }
        std::thread::sleep(GLANCE);
    }
    Ok(())
}

/// An error unless something is so.
pub(super) fn check(is_so: bool, why_not: impl FnOnce() -> String) -> Result<()> {
    if is_so { Ok(()) } else { Err(Error::Broken(why_not())) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shell(script: &str, folder: &Path) -> Running {
        Running::start(Command::new("sh").args(["-c", script]), &folder.join("log")).expect("sh starts")
    }

    #[test]
    fn programs_end_are_killed_and_are_stopped() {
        let folder = tempfile::tempdir().expect("a folder");
        let ended = shell("echo out; echo err >&2; exit 3", folder.path()).ended(GRACE).expect("it ends");
        assert_eq!((ended.code, ended.stdout.as_str(), ended.stderr.as_str()), (3, "out\n", "err\n"));
        let wrong = ended.must_be(0, "a shell").map(|_| ()).expect_err("it is 3");
        assert!(wrong.to_string().contains("a shell: exit code 3, not 0"), "{wrong}");
        assert!(shell("sleep 60", folder.path()).kill().expect("it can be killed"), "it was there");
        let dropped = shell("exec sleep 60", folder.path());
        let id = dropped.id();
        drop(dropped);
        assert!(!Path::new(&format!("/proc/{id}")).exists(), "nobody waits, so it is stopped");
        let late = shell("exec sleep 60", folder.path()).ended(Duration::from_millis(50));
        assert!(late.is_err(), "it takes too long");
    }
}
