//! Folders with a manifest and models, and what must be true of them afterwards.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use serde_json::Value;
use tempfile::TempDir;

use super::models;
use super::running::{Ended, Running, check};
use crate::error::{Error, Naming, Result};

/// How long a program has for a manifest of short rows.
const LIMIT: Duration = Duration::from_secs(300);

/// Models beside each manifest: `m0.ply` and so on.
pub(super) const MODELS: u64 = 5;

/// The program, and a folder for all that is made, which is removed at the end.
pub(super) struct Ground {
    scratch: TempDir,
    program: PathBuf,
    names: Cell<u32>,
}

/// A folder with a manifest `jobs.csv`, whose rows write below `out`.
pub(super) struct Site<'a> {
    ground: &'a Ground,
    folder: PathBuf,
}

impl Ground {
    pub(super) fn new(program: PathBuf) -> Result<Self> {
        let scratch = tempfile::Builder::new().prefix("guard4d-farm-").tempdir().of_file(&std::env::temp_dir())?;
        Ok(Self { scratch, program, names: Cell::new(0) })
    }

    /// The program that is looked at.
    pub(super) fn program(&self) -> &Path {
        &self.program
    }

    /// A path that nothing else has.
    pub(super) fn fresh(&self) -> PathBuf {
        self.names.set(self.names.get() + 1);
        self.scratch.path().join(self.names.get().to_string())
    }

    /// A new, empty folder.
    pub(super) fn folder(&self) -> Result<PathBuf> {
        let path = self.fresh();
        fs::create_dir(&path).of_file(&path)?;
        Ok(path)
    }

    /// A site in a folder of its own.
    pub(super) fn site(&self, manifest: &str) -> Result<Site<'_>> {
        self.site_in(self.folder()?, manifest)
    }

    /// A site in this folder.
    pub(super) fn site_in(&self, folder: PathBuf, manifest: &str) -> Result<Site<'_>> {
        let site = Site { ground: self, folder };
        for seed in 0..MODELS {
            site.put(&format!("m{seed}.ply"), &models::ply(seed))?;
        }
        site.put("jobs.csv", manifest.as_bytes())?;
        Ok(site)
    }

    /// Starts a program beside this one.
    pub(super) fn start(&self, command: &mut Command) -> Result<Running> {
        Running::start(command, &self.fresh())
    }

    /// Runs a program to its end.
    pub(super) fn run(&self, command: &mut Command) -> Result<Ended> {
        self.start(command)?.ended(LIMIT)
    }
}

impl Site<'_> {
    pub(super) fn path(&self, inside: &str) -> PathBuf {
        self.folder.join(inside)
    }

    pub(super) fn put(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.path(name);
        fs::write(&path, bytes).of_file(&path)
    }

    /// The words of `guard4d farm ACTION jobs.csv …`, the program first.
    pub(super) fn words(&self, action: &str, more: &[&str]) -> Vec<String> {
        let manifest = self.path("jobs.csv");
        let mut words = vec![self.ground.program().display().to_string(), "farm".to_owned(), action.to_owned()];
        words.push(manifest.display().to_string());
        words.extend(more.iter().map(|word| (*word).to_owned()));
        words
    }

    /// `guard4d farm ACTION jobs.csv …`
    pub(super) fn command(&self, action: &str, more: &[&str]) -> Command {
        let words = self.words(action, more);
        let mut command = Command::new(&words[0]);
        command.args(&words[1..]);
        command
    }

    /// Runs that to its end.
    pub(super) fn act(&self, action: &str, more: &[&str]) -> Result<Ended> {
        self.ground.run(&mut self.command(action, more))
    }

    /// What `guard4d farm status` says.
    pub(super) fn status(&self) -> Result<Value> {
        json(&self.act("status", &["--json"])?.stdout)
    }

    /// Runs what is left; an error unless all rows are done then.
    pub(super) fn finish(&self, more: &[&str], rows: usize) -> Result<()> {
        let run = self.act("run", &[&["--json"], more].concat())?.must_be(0, "the last run of a manifest")?;
        let summary = json(&run.stdout)?;
        let done = summary["done"].as_u64().unwrap_or(0) + summary["already"].as_u64().unwrap_or(0);
        check(done == rows as u64 && summary["elsewhere"] == 0, || format!("the last run left rows: {summary}"))
    }

    /// All that was made: files below `out`, hidden ones too.
    pub(super) fn made(&self) -> Result<BTreeMap<String, Vec<u8>>> {
        let out = self.path("out");
        let mut found = BTreeMap::new();
        for path in files_below(&out)? {
            let name = path.strip_prefix(&out).unwrap_or(&path).display().to_string();
            found.insert(name, fs::read(&path).of_file(&path)?);
        }
        Ok(found)
    }

    /// An error unless what was made is what a quiet run made, byte for byte.
    pub(super) fn must_match(&self, quiet: &BTreeMap<String, Vec<u8>>) -> Result<()> {
        let made = self.made()?;
        let of_both = made.keys().chain(quiet.keys());
        let differing: Vec<_> = of_both.filter(|name| made.get(*name) != quiet.get(*name)).collect();
        check(differing.is_empty(), || format!("not what a quiet run makes: {differing:?}"))
    }

    /// Files that nobody asked for: partial ones, and claims.
    pub(super) fn litter(&self) -> Result<Vec<String>> {
        let name = |path: &PathBuf| path.strip_prefix(&self.folder).unwrap_or(path).display().to_string();
        let is_expected = |name: &String| {
            let is_record =
                name.starts_with("jobs.farm/") && name.ends_with(".jsonl") && name.matches('/').count() == 1;
            let is_out = name.starts_with("out/") && !name.contains("partial");
            let is_input = !name.contains('/') && !name.starts_with('.');
            is_record || is_out || is_input
        };
        Ok(files_below(&self.folder)?.iter().map(name).filter(|name| !is_expected(name)).collect())
    }

    /// All whole records.
    pub(super) fn records(&self) -> Result<Vec<Value>> {
        let mut records = Vec::new();
        for path in files_below(&self.path("jobs.farm"))? {
            if path.extension().is_some_and(|end| end == "jsonl") {
                let text = fs::read_to_string(&path).of_file(&path)?;
                // A last line without an end was cut off.
                let whole = text.rfind('\n').map_or("", |end| &text[..end]);
                for line in whole.lines() {
                    records.push(json(line)?);
                }
            }
        }
        Ok(records)
    }
}

/// What a program prints for programs.
pub(super) fn json(text: &str) -> Result<Value> {
    serde_json::from_str(text).map_err(|error| Error::Broken(format!("{error}, but JSON was expected: {text}")))
}

/// How many records of one state there are, beyond the first of each row.
pub(super) fn repeated(records: &[Value], state: &str) -> usize {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for record in records.iter().filter(|record| record["state"] == state) {
        *counts.entry(record["id"].as_str().unwrap_or_default()).or_default() += 1;
    }
    counts.values().map(|count| count - 1).sum()
}

/// How many records are of this state.
pub(super) fn count(records: &[Value], state: &str) -> usize {
    records.iter().filter(|record| record["state"] == state).count()
}

/// All files below a folder; none of one that is not there.
fn files_below(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    if folder.is_dir() {
        for entry in fs::read_dir(folder).of_file(folder)? {
            let path = entry.of_file(folder)?.path();
            if path.is_dir() {
                found.extend(files_below(&path)?);
            } else {
                found.push(path);
            }
        }
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn litter_and_repeated_rows_are_found() {
        let ground = Ground::new(PathBuf::from("guard4d")).expect("a folder");
        let site = ground.site("id,job,input,output\n").expect("a site");
        for folder in ["out/b", "jobs.farm/claims"] {
            fs::create_dir_all(site.path(folder)).expect("writable");
        }
        let record = |state: &str| format!("{{\"id\":\"a\",\"state\":\"{state}\"}}\n");
        let lines = [record("running"), record("done"), record("done"), "{\"id\":".to_owned()].concat();
        for (name, text) in [("out/b/0.ply", "b"), ("out/a.glb", "a"), ("jobs.farm/h-1-2.jsonl", &lines)] {
            site.put(name, text.as_bytes()).expect("writable");
        }
        assert_eq!(site.litter().expect("readable"), Vec::<String>::new());
        assert_eq!(site.made().expect("readable").len(), 2);
        for name in ["out/.a.glb.partial-7", "jobs.farm/claims/a", "jobs.farm/claims/.h-1-2"] {
            site.put(name, b"").expect("writable");
        }
        assert_eq!(site.litter().expect("readable").len(), 3);
        let records = site.records().expect("readable");
        assert_eq!((records.len(), repeated(&records, "done"), repeated(&records, "running")), (3, 1, 0));
        assert_eq!(count(&records, "done"), 2);
        assert!(site.must_match(&BTreeMap::new()).is_err(), "more was made");
    }
}
