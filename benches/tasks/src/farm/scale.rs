//! Many short rows on one machine.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::figures::Figures;
use super::running::{Running, check, wait_until};
use super::site::{Ground, MODELS, Site, json};
use crate::error::{Naming, Result};

/// Rows after which memory is read for the first time.
const WARM: usize = 2000;

/// How many times as many rows are planned.
const PLANNED: usize = 10;

/// How long the rows have together. Who waits longer has found a fault.
const LIMIT: Duration = Duration::from_secs(24 * 3600);

/// Most memory that a row may cost a worker for as long as it runs, bytes.
const BYTES_OF_ROW: u64 = 4096;

/// Memory of a process, KiB.
#[derive(Clone, Copy, Default)]
struct Memory {
    now: u64,
    peak: u64,
}

/// Does and plans rows.
pub(super) fn run(ground: &Ground, rows: usize, figures: &mut Figures) -> Result<()> {
    let site = ground.site(&manifest(rows))?;
    work(ground, &site, rows, figures)?;
    status(&site, rows, "farm status", figures)?;
    let begun = Instant::now();
    site.act("report", &["--out", &site.path("report.html").display().to_string()])?.must_be(0, "the report")?;
    figures.add_fine("farm report", begun.elapsed().as_secs_f64(), "s");
    status(&site, rows, "farm status behind it", figures)?;
    drop(site);
    plan(ground, rows * PLANNED, figures)
}

/// Asks how far the rows are, which are all done.
fn status(site: &Site<'_>, rows: usize, name: &str, figures: &mut Figures) -> Result<()> {
    let begun = Instant::now();
    let status = site.status()?;
    figures.add_fine(name, begun.elapsed().as_secs_f64(), "s");
    check(status["done"] == rows, || format!("not all of {rows} rows are done: {status}"))
}

fn manifest(rows: usize) -> String {
    let row = |n: usize| format!("r{n},convert,m{}.ply,out/r{n}.ply\n", n as u64 % MODELS);
    let rows: String = (0..rows).map(row).collect();
    format!("id,job,input,output\n{rows}")
}

/// Runs all rows in one worker, and reads its memory meanwhile.
fn work(ground: &Ground, site: &Site<'_>, rows: usize, figures: &mut Figures) -> Result<()> {
    let warm = WARM.min(rows / 2);
    let begun = Instant::now();
    let mut worker = ground.start(&mut site.command("run", &["--json"]))?;
    let mut records = Records::new(site.path("jobs.farm"));
    let (mut first, mut last) = (None, Memory::default());
    wait_until("all rows are done", LIMIT, || {
        last = memory(&worker)?.unwrap_or(last);
        if first.is_none() && records.rows()? >= warm {
            first = Some((last, begun.elapsed()));
        }
        worker.is_over()
    })?;
    let seconds = begun.elapsed().as_secs_f64();
    let summary = json(&worker.ended(LIMIT)?.must_be(0, "the worker")?.stdout)?;
    check(summary["done"] == rows, || format!("not all of {rows} rows were done: {summary}"))?;
    figures.add("rows", rows, "rows");
    figures.add_fine("all rows", seconds, "s");
    figures.add_fine("rows in a second", rows as f64 / seconds, "rows/s");
    let Some((first, until)) = first else {
        figures.add("memory at the end", last.now, "KiB");
        return Ok(());
    };
    let until = until.as_secs_f64();
    figures.add_fine(&format!("rows in a second, the first {warm}"), warm as f64 / until, "rows/s");
    figures.add_fine("rows in a second, the others", (rows - warm) as f64 / (seconds - until), "rows/s");
    figures.add(&format!("memory after {warm} rows"), first.now, "KiB");
    figures.add("memory at the end", last.now, "KiB");
    figures.add("memory at its peak", last.peak, "KiB");
    let grown = last.now.saturating_sub(first.now) * 1024 / (rows - warm) as u64;
    figures.add("memory that a row costs", grown, "bytes");
    check(grown <= BYTES_OF_ROW, || format!("a row costs {grown} bytes of memory, more than {BYTES_OF_ROW}"))
}

/// Plans many rows.
fn plan(ground: &Ground, rows: usize, figures: &mut Figures) -> Result<()> {
    let site = ground.site(&manifest(rows))?;
    let begun = Instant::now();
    let mut planner = ground.start(&mut site.command("plan", &["--json", "--shards", "1000"]))?;
    let mut most = Memory::default();
    wait_until("the plan is made", LIMIT, || {
        most = memory(&planner)?.unwrap_or(most);
        planner.is_over()
    })?;
    let seconds = begun.elapsed().as_secs_f64();
    let plan = json(&planner.ended(LIMIT)?.must_be(0, "farm plan")?.stdout)?;
    check(plan["rows"] == rows, || format!("{} rows were planned, not {rows}", plan["rows"]))?;
    figures.add("rows planned", rows, "rows");
    figures.add_fine("the plan", seconds, "s");
    figures.add("memory of the plan", most.peak, "KiB");
    Ok(())
}

/// Memory of a program; none of one that has ended.
fn memory(program: &Running) -> Result<Option<Memory>> {
    Ok(fs::read_to_string(format!("/proc/{}/status", program.id())).ok().and_then(|text| memory_in(&text)))
}

fn memory_in(status: &str) -> Option<Memory> {
    let field =
        |name: &str| status.lines().find_map(|line| line.strip_prefix(name)?.strip_suffix("kB")?.trim().parse().ok());
    Some(Memory { now: field("VmRSS:")?, peak: field("VmHWM:")? })
}

/// The records of the only worker, read on as they grow.
struct Records {
    folder: PathBuf,
    file: Option<File>,
    lines: usize,
}

impl Records {
    const fn new(folder: PathBuf) -> Self {
        Self { folder, file: None, lines: 0 }
    }

    /// Rows that have ended: each has a record of its beginning and one of its end.
    fn rows(&mut self) -> Result<usize> {
        if self.file.is_none() {
            let Some(path) = journal(&self.folder) else { return Ok(0) };
            self.file = Some(File::open(&path).of_file(&path)?);
        }
        let mut bytes = Vec::new();
        if let Some(file) = &mut self.file {
            file.read_to_end(&mut bytes).of_file(&self.folder)?;
        }
        self.lines += bytes.iter().filter(|byte| **byte == b'\n').count();
        Ok(self.lines / 2)
    }
}

fn journal(folder: &Path) -> Option<PathBuf> {
    let entries = fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    entries.into_iter().find(|path| path.extension().is_some_and(|end| end == "jsonl"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_read_as_the_system_tells_it() {
        let status = "Name:\tguard4d\nVmHWM:\t    2048 kB\nVmRSS:\t    1024 kB\n";
        let memory = memory_in(status).expect("it is there");
        assert_eq!((memory.now, memory.peak), (1024, 2048));
        assert!(memory_in("Name:\tguard4d\n").is_none(), "one that has ended has none");
    }
}
