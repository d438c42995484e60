//! Arrays of Slurm, as `guard4d farm submit` makes them.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::cluster::Cluster;
use super::figures::Figures;
use super::running::{check, wait_until};
use super::site::{Ground, MODELS, Site, count, json, repeated};
use crate::error::{Naming, Result};
use crate::workspace::{Workspace, say};

/// How long a job has.
const LIMIT: Duration = Duration::from_secs(600);

/// A task's time in the run that is not given enough, minutes. Slurm gives notice up to two minutes before its end.
const SHORT_MIN: &str = "2";

/// How long rows would take that such a task is given: longer than until the notice, which comes within a minute.
const LONG: Duration = Duration::from_secs(75);

/// What the checks share.
struct Checks<'a> {
    ground: &'a Ground,
    cluster: Cluster,
    /// The built-in scene.
    scene: PathBuf,
}

/// Starts a cluster of one node, and submits.
pub(super) fn run(workspace: &Workspace, ground: &Ground, figures: &mut Figures) -> Result<()> {
    workspace.need(&["loader", "lavapipe", "munge", "slurm-client", "slurmctld", "slurmd"])?;
    let begun = Instant::now();
    let cluster = Cluster::start(ground.folder()?)?;
    figures.add_fine("start of the cluster", begun.elapsed().as_secs_f64(), "s");
    let checks = Checks {
        ground,
        cluster,
        scene: workspace.path("engine/assets/demo-scene").canonicalize().of_file(workspace.root())?,
    };
    checks.array(figures)?;
    checks.bad_asset(figures)?;
    let film = checks.film()?;
    checks.drained(&film, figures)?;
    checks.out_of_time(&film, figures)
}

fn conversions(rows: usize) -> String {
    let row = |n: usize| format!("r{n},convert,m{}.ply,out/r{n}.glb\n", n as u64 % MODELS);
    let rows: String = (0..rows).map(row).collect();
    format!("id,job,input,output\n{rows}")
}

/// A row that takes a while.
struct Film {
    /// All its frames.
    made: Vec<u8>,
    /// With the start of the program.
    took: Duration,
}

impl Checks<'_> {
    /// Hands a manifest to Slurm; the job's number.
    fn submit(&self, site: &Site<'_>, shards: usize, minutes: Option<&str>) -> Result<String> {
        let shards = shards.to_string();
        let mut command = site.command("submit", &["--engine", "slurm", "--shards", &shards]);
        command.env("GUARD4D_DEVICE", "cpu");
        if let Some(minutes) = minutes {
            command.env("SBATCH_TIMELIMIT", minutes);
        }
        let ended = self.ground.run(self.cluster.show(&mut command))?.must_be(0, "farm submit --engine slurm")?;
        Ok(ended.stdout.trim().to_owned())
    }

    /// Twelve rows in four tasks on two cores make what they make without Slurm.
    fn array(&self, figures: &mut Figures) -> Result<()> {
        const ROWS: usize = 12;
        say("farm: an array of four tasks");
        let quiet = self.ground.site(&conversions(ROWS))?;
        quiet.finish(&[], ROWS)?;
        let site = self.ground.site(&conversions(ROWS))?;
        let begun = Instant::now();
        let job = self.submit(&site, 4, None)?;
        let tasks = self.cluster.ended(&job, LIMIT)?;
        figures.add_fine("array of 12 rows in 4 tasks", begun.elapsed().as_secs_f64(), "s");
        let completed = tasks.iter().filter(|task| task.state == "COMPLETED").count();
        check(completed == 4 && tasks.len() == 4, || format!("not all tasks were completed: {tasks:?}"))?;
        check(site.status()?["done"] == ROWS, || "not all rows are done".to_owned())?;
        site.must_match(&quiet.made()?)
    }

    /// One bad asset among ten: its task ends with 3, all others with 0, and what comes after the array runs.
    fn bad_asset(&self, figures: &mut Figures) -> Result<()> {
        const ROWS: usize = 10;
        say("farm: a bad asset");
        let site = self.ground.site(&(conversions(ROWS - 1) + "bad,convert,jobs.csv,out/bad.glb\n"))?;
        let job = self.submit(&site, 4, None)?;
        let (script, report) = (site.path("report.sh"), site.path("report.json"));
        let words = site.words("status", &["--json"]).join("' '");
        let text = format!("#!/bin/bash\n'{words}' >'{}'\nexit 0\n", report.display());
        fs::write(&script, text).of_file(&script)?;
        let [script, log] = [script, site.path("report.log")].map(|path| path.display().to_string());
        let after = format!("afterany:{job}");
        let reporting = self.cluster.ask("sbatch", &["--parsable", "-d", &after, "-o", &log, &script])?;
        let tasks = self.cluster.ended(&job, LIMIT)?;
        let codes: Vec<u32> = tasks.iter().map(|task| task.exit_code).collect();
        let highest = codes.iter().max().copied().unwrap_or(0);
        check(highest == 3 && codes.iter().filter(|code| **code == 0).count() == 3, || {
            format!("tasks should end with 3, 0, 0 and 0, not {codes:?}")
        })?;
        let reported = self.cluster.ended(reporting.trim(), LIMIT)?;
        check(reported.iter().all(|task| task.state == "COMPLETED"), || format!("the report: {reported:?}"))?;
        let status = json(&fs::read_to_string(&report).of_file(&report)?)?;
        check(status["failed"] == 1 && status["done"] == ROWS - 1, || format!("the report says {status}"))?;
        figures.add("highest exit code of an array with a bad asset", highest, "");
        figures.add("rows done beside it", ROWS - 1, "rows");
        Ok(())
    }

    fn films(&self, rows: usize) -> String {
        let scene = self.scene.display();
        let row = |n: usize| format!("f{n},render,{scene},out/f{n},2,24,200x200\n");
        let rows: String = (0..rows).map(row).collect();
        format!("id,job,input,output,orbit,frames,size\n{rows}")
    }

    /// What a film is, and how long it takes without Slurm.
    fn film(&self) -> Result<Film> {
        let site = self.ground.site(&self.films(1))?;
        let mut command = site.command("run", &[]);
        let begun = Instant::now();
        self.ground.run(command.env("GUARD4D_DEVICE", "cpu"))?.must_be(0, "a row that renders")?;
        let took = begun.elapsed();
        Ok(Film { made: frames(&site, 0)?, took })
    }

    /// A node that is drained ends its tasks and begins no other until it is resumed.
    fn drained(&self, film: &Film, figures: &mut Figures) -> Result<()> {
        const ROWS: usize = 8;
        say("farm: a node is drained");
        let site = self.ground.site(&self.films(ROWS))?;
        let job = self.submit(&site, 4, None)?;
        wait_until("a row is begun", LIMIT, || Ok(count(&site.records()?, "running") > 0))?;
        let node = format!("nodename={}", self.cluster.node());
        self.cluster.ask("scontrol", &["update", &node, "state=drain", "reason=test"])?;
        wait_until("the node is drained", LIMIT, || Ok(self.cluster.state()?.starts_with("drained")))?;
        let waiting = self.cluster.tasks(&job)?.iter().filter(|task| task.state == "PENDING").count();
        let done = site.status()?["done"].as_u64().unwrap_or(0);
        check(waiting > 0 && done < ROWS as u64, || format!("{waiting} tasks wait, {done} rows are done"))?;
        self.cluster.ask("scontrol", &["update", &node, "state=resume"])?;
        let tasks = self.cluster.ended(&job, LIMIT)?;
        check(tasks.iter().all(|task| task.state == "COMPLETED"), || format!("not all were completed: {tasks:?}"))?;
        check(site.status()?["done"] == ROWS, || "not all rows are done".to_owned())?;
        for row in 0..ROWS {
            check(frames(&site, row)? == film.made, || format!("f{row} is not what it is without Slurm"))?;
        }
        figures.add("rows done of 8 when the node was drained", done, "rows");
        Ok(())
    }

    /// A task that runs out of time is told, ends with 75, is requeued, and goes on.
    fn out_of_time(&self, film: &Film, figures: &mut Figures) -> Result<()> {
        say("farm: a task runs out of time");
        let needed = LONG.as_millis().div_ceil(film.took.as_millis().max(1));
        let rows = 2 + usize::try_from(needed).unwrap_or(usize::MAX / 2);
        let site = self.ground.site(&self.films(rows))?;
        let begun = Instant::now();
        let job = self.submit(&site, 1, Some(SHORT_MIN))?;
        let is_requeued = || {
            std::thread::sleep(Duration::from_millis(200));
            let tasks = self.cluster.tasks(&job)?;
            Ok(tasks.iter().all(|task| task.restarts == 1 && task.state == "PENDING"))
        };
        wait_until("the task is requeued", LIMIT, is_requeued)?;
        figures.add_fine("end of a task with 2 minutes", begun.elapsed().as_secs_f64(), "s");
        check(self.cluster.logged("WEXITSTATUS 75")?, || "the task was requeued, yet not for exit code 75".to_owned())?;
        let records = site.records()?;
        // None where the notice came between two rows.
        let codes: Vec<_> = records.iter().filter(|r| r["state"] == "interrupted").map(|r| &r["exit_code"]).collect();
        check(codes.len() <= 1 && codes.iter().all(|code| **code == 75), || {
            format!("at most one row should be interrupted, with 75, not {codes:?}")
        })?;
        figures.add("rows interrupted by its notice", codes.len(), "rows");
        let before = count(&records, "done");
        check(before > 0 && before < rows, || format!("{before} of {rows} rows were done before the notice"))?;
        // Slurm waits two minutes before it begins a requeued task.
        let task = format!("jobid={job}_1");
        self.cluster.ask("scontrol", &["update", &task, "StartTime=now", "TimeLimit=60"])?;
        let tasks = self.cluster.ended(&job, LIMIT)?;
        check(tasks.iter().all(|task| task.state == "COMPLETED"), || format!("it did not go on: {tasks:?}"))?;
        let records = site.records()?;
        check(count(&records, "done") == rows && repeated(&records, "done") == 0, || {
            format!("{} records of {rows} rows are done", count(&records, "done"))
        })?;
        for row in 0..rows {
            check(frames(&site, row)? == film.made, || format!("f{row} is not what it is without Slurm"))?;
        }
        figures.add("rows of that task", rows, "rows");
        figures.add("rows done before its notice", before, "rows");
        figures.add("restarts of it", tasks.iter().map(|task| task.restarts).sum::<u32>(), "");
        Ok(())
    }
}

/// All frames of a film, one after the other.
fn frames(site: &Site<'_>, row: usize) -> Result<Vec<u8>> {
    let folder = format!("f{row}");
    let of_film = |name: &String| Path::new(name).starts_with(&folder);
    Ok(site.made()?.into_iter().filter(|(name, _)| of_film(name)).flat_map(|(_, bytes)| bytes).collect())
}
