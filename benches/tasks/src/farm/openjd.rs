//! A manifest in the runner of openjd-cli.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use serde_json::Value;

use super::figures::Figures;
use super::models;
use super::running::{Ended, check};
use super::site::{Ground, MODELS, Site, json};
use crate::error::{Naming, Result};
use crate::pinned::{install_once, pip_install, python_environment};
use crate::workspace::{Workspace, say};

/// Rows of the manifest, and chunks of them.
const ROWS: usize = 12;
const CHUNKS: usize = 3;

/// The row whose input is missing, in the middle of the second chunk.
const BAD: usize = 5;

/// The runner.
struct Runner<'a> {
    ground: &'a Ground,
    program: PathBuf,
}

/// Installs the runner where it is missing, and lets it run a good manifest and one with a bad row.
pub(super) fn run(workspace: &Workspace, ground: &Ground, figures: &mut Figures) -> Result<()> {
    workspace.need(&["venv"])?;
    let (folder, packages) = (workspace.path("target/openjd"), workspace.path("benches/tasks/openjd.txt"));
    let list = fs::read_to_string(&packages).of_file(&packages)?;
    install_once(&folder, &list, || {
        say("installing what benches/tasks/openjd.txt names");
        python_environment(&folder, false)?;
        pip_install(&folder, &packages)
    })?;
    let runner = Runner { ground, program: folder.join("bin/openjd") };
    figures.add("rows of the manifest", ROWS, "rows");
    good(&runner, figures)?;
    bad(&runner, figures)
}

fn manifest(bad: Option<usize>) -> String {
    let row = |n: usize| {
        let model = if bad == Some(n) { "none".to_owned() } else { format!("m{}", n as u64 % MODELS) };
        format!("r{n},convert,{model}.ply,out/r{n}.glb\n")
    };
    let rows: String = (0..ROWS).map(row).collect();
    format!("id,job,input,output\n{rows}")
}

/// All chunks are done, with the bytes of a run without OpenJD, and the runner reads how far they are.
fn good(runner: &Runner<'_>, figures: &mut Figures) -> Result<()> {
    let quiet = runner.ground.site(&manifest(None))?;
    quiet.finish(&[], ROWS)?;
    let site = runner.ground.site(&manifest(None))?;
    let template = template(&site)?;
    runner.command(&["check"], &template)?.must_be(0, "openjd check")?;
    let begun = Instant::now();
    let ended = runner.command(&["run"], &template)?.must_be(0, "openjd run")?;
    figures.add_fine("openjd run", begun.elapsed().as_secs_f64(), "s");
    let report = json(&ended.stdout)?;
    check(report["status"] == "success", || format!("openjd says {}", report["status"]))?;
    check(report["chunks_run"] == CHUNKS, || format!("openjd ran {} chunks", report["chunks_run"]))?;
    site.must_match(&quiet.made()?)?;
    let said = messages(&report);
    let per_chunk = ROWS / CHUNKS;
    for row in 1..=per_chunk {
        for line in
            [format!("openjd_progress: {}", 100 * row / per_chunk), format!("openjd_status: rows {row}/{per_chunk}")]
        {
            let times = said.iter().filter(|said| **said == line).count();
            check(times == CHUNKS, || format!("the runner's log has `{line}` {times} times"))?;
        }
    }
    let told = said.iter().filter(|line| line.starts_with("openjd_progress: ")).count();
    figures.add("chunks that openjd ran", CHUNKS, "chunks");
    figures.add("lines of progress in its log", told, "lines");
    Ok(())
}

/// A chunk with a bad row has failed, and its other rows are done.
fn bad(runner: &Runner<'_>, figures: &mut Figures) -> Result<()> {
    let site = runner.ground.site(&manifest(Some(BAD)))?;
    let template = template(&site)?;
    runner.command(&["run"], &template)?.must_be(1, "openjd run with a chunk that fails")?;
    let status = site.status()?;
    let per_chunk = ROWS / CHUNKS;
    let through = (BAD / per_chunk + 1) * per_chunk;
    check(status["failed"] == 1 && status["done"] == through - 1, || {
        format!("all rows but one of the first {through} should be done: {status}")
    })?;
    figures.add("rows done beside a bad one, in chunks up to its own", through - 1, "rows");
    // Locally the runner begins no chunk after one that failed.
    check(status["pending"] == ROWS - through, || format!("later chunks were begun: {status}"))?;
    site.put("none.ply", &models::ply(0))?;
    runner.ground.run(&mut site.command("run", &["--retry-failed"]))?.must_be(0, "the mended manifest")?;
    check(site.status()?["done"] == ROWS, || "not all rows of the mended manifest are done".to_owned())
}

fn template(site: &Site<'_>) -> Result<PathBuf> {
    let chunks = CHUNKS.to_string();
    site.act("submit", &["--engine", "openjd", "--shards", &chunks])?.must_be(0, "farm submit --engine openjd")?;
    Ok(site.path("jobs.farm/openjd.template.json"))
}

impl Runner<'_> {
    /// `openjd ACTION TEMPLATE --output json`
    fn command(&self, action: &[&str], template: &Path) -> Result<Ended> {
        self.ground.run(Command::new(&self.program).args(action).arg(template).args(["--output", "json"]))
    }
}

/// What the runner's log holds of what tasks printed.
fn messages(report: &Value) -> Vec<&str> {
    report["logs"].as_array().into_iter().flatten().filter_map(|entry| entry["message"].as_str()).collect()
}
