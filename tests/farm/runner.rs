//! Workers: what is done stays, what fails stops nothing else, and what was broken off is gone on with.

use std::collections::BTreeMap;
use std::fs;
use std::num::NonZeroUsize;
use std::sync::Mutex;

use guard4d_engine::error::EngineError;
use guard4d_engine::farm::crowd::DeviceMemory;
use guard4d_engine::farm::journal::Journal;
use guard4d_engine::farm::manifest::{Manifest, Row};
use guard4d_engine::farm::record::{Record, State};
use guard4d_engine::farm::runner::{Attempt, Ended, Jobs, Policy, Summary, Worker};
use guard4d_engine::farm::selection::Selection;
use guard4d_kernels::KernelError;
use serde_json::Value;

use super::Farm;
use crate::support::names;

/// Jobs that copy their input; the column `does` says what goes wrong.
#[derive(Default)]
struct Copying<'a> {
    folder: std::path::PathBuf,
    ran: Vec<(String, Attempt)>,
    /// All workers' rows, where there are several.
    all: Option<&'a Mutex<Vec<String>>>,
    forgotten: usize,
    is_stopped: bool,
    /// How many light rows were done at once, each time.
    at_once: Vec<usize>,
    /// Memory of the device, if there is one.
    memory: Option<DeviceMemory>,
}

impl Jobs for Copying<'_> {
    fn run(&mut self, row: &Row, attempt: Attempt) -> Result<Ended, EngineError> {
        self.ran.push((row.id.clone(), attempt));
        if let Some(all) = self.all {
            all.lock().expect("no test panics in it").push(row.id.clone());
            std::thread::sleep(std::time::Duration::from_millis(2));
        }
        let output = self.folder.join(&row.output);
        match row.columns.get("does").map_or("", String::as_str) {
            "fail" => {
                return Err(EngineError::MissingInput {
                    path: row.input.clone().into(),
                    expected: "a file".to_owned(),
                });
            }
            "stop" => {
                self.is_stopped = true;
                return Err(EngineError::Stopped);
            }
            "lose the device" if self.forgotten < 1 => return Err(lost()),
            "lose every device" => return Err(lost()),
            _ => {}
        }
        assert!(attempt.replaces || !output.exists(), "{}: what is there may not be replaced", row.id);
        let input =
            if row.input.is_empty() { Vec::new() } else { fs::read(self.folder.join(&row.input)).expect("there") };
        fs::write(&output, input).expect("writable");
        let shortfall = row.columns.contains_key("short").then(|| "not good enough".to_owned());
        Ok(Ended { exit_code: u8::from(shortfall.is_some()), shortfall, result: Value::Null })
    }

    fn is_light(&self, row: &Row) -> bool {
        row.columns.contains_key("light")
    }

    fn device_memory(&self) -> Option<DeviceMemory> {
        self.memory
    }

    fn run_at_once(&mut self, rows: &[(&Row, Attempt)]) -> Vec<Result<Ended, EngineError>> {
        self.at_once.push(rows.len());
        rows.iter().map(|(row, attempt)| self.run(row, *attempt)).collect()
    }

    fn notes(&self, row: &Row) -> BTreeMap<String, String> {
        row.columns.clone()
    }

    fn forget_device(&mut self) {
        self.forgotten += 1;
    }

    fn is_stopped(&self) -> bool {
        self.is_stopped
    }
}

fn lost() -> EngineError {
    EngineError::Kernel(KernelError::DeviceLost { last_pass: "none".to_owned() })
}

/// Does all rows; what came of it, and which were tried.
fn run(farm: &Farm, policy: Policy) -> (Summary, Vec<(String, Attempt)>) {
    let mut jobs = Copying { folder: farm.folder.path().to_path_buf(), ..Copying::default() };
    let summary = run_with(&farm.manifest(), policy, &mut jobs);
    (summary, jobs.ran)
}

fn run_with(manifest: &Manifest, policy: Policy, jobs: &mut Copying<'_>) -> Summary {
    let places = Selection::default().places(manifest).expect("all rows");
    let mut watch = |_: guard4d_engine::farm::runner::Event<'_>| ();
    Worker::new(manifest, policy, jobs, &mut watch).and_then(|mut worker| worker.run(&places)).expect("writable")
}

/// All that workers wrote down.
fn records(farm: &Farm) -> Vec<Record> {
    let state = farm.manifest().state();
    let files = names(&state).into_iter().filter(|name| name.ends_with(".jsonl"));
    let texts: String = files.map(|name| fs::read_to_string(state.join(name)).expect("readable")).collect();
    texts.lines().map(|line| serde_json::from_str(line).expect("a record")).collect()
}

/// Names of the rows that were tried.
fn ids(ran: &[(String, Attempt)]) -> Vec<&str> {
    ran.iter().map(|(id, _)| id.as_str()).collect()
}

#[test]
fn what_is_done_stays_and_what_changed_is_done_again() {
    let lines = ["id,job,input,output,size", "a,copy,x,a.out,", "b,copy,y,b.out,", "c,copy,a.out,c.out,"];
    let mut farm = Farm::new(&lines);
    farm.put("x", "1");
    farm.put("y", "2");
    let (summary, ran) = run(&farm, Policy::default());
    assert_eq!((summary.done, ids(&ran)), (3, vec!["a", "b", "c"]));
    assert_eq!(fs::read(farm.at("c.out")).expect("made"), b"1", "it read what another made");
    let (summary, ran) = run(&farm, Policy::default());
    assert_eq!((summary.done, summary.already, ids(&ran)), (0, 3, vec![]), "nothing is left to do");
    assert_eq!(names(&farm.manifest().state().join("claims")), Vec::<String>::new(), "no claim is left");

    farm.put("b.out", "spoilt");
    assert_eq!(ids(&run(&farm, Policy::default()).1), ["b"], "what was made is no longer there");
    farm.put("y", "3");
    assert_eq!(ids(&run(&farm, Policy::default()).1), ["b"], "another input");
    farm.put("x", "4");
    assert_eq!(ids(&run(&farm, Policy::default()).1), ["a", "c"], "and all that follows from it");
    assert_eq!(fs::read(farm.at("c.out")).expect("made"), b"4");
    farm.put("jobs.csv", &lines.join("\n").replace("b.out,", "b.out,8x8"));
    farm.path = farm.at("jobs.csv");
    assert_eq!(ids(&run(&farm, Policy::default()).1), ["b"], "another setting");
}

#[test]
fn a_row_that_fails_stops_only_those_that_need_it() {
    let farm = Farm::new(&[
        "id,job,input,output,does,short",
        "bad,copy,x,bad.out,fail,",
        "poor,copy,x,poor.out,,yes",
        "after,copy,bad.out,after.out,,",
        "later,copy,after.out,later.out,,",
        "good,copy,x,good.out,,",
    ]);
    farm.put("x", "1");
    let (summary, ran) = run(&farm, Policy::default());
    assert_eq!((summary.done, ids(&ran)), (1, vec!["bad", "poor", "good"]));
    let causes: Vec<&str> = summary.failed.iter().map(|(_, why)| why.as_str()).collect();
    assert_eq!(causes[1..], ["not good enough", "it needs `bad`, which failed", "it needs `after`, which failed"]);
    assert!(causes[0].contains("not found"), "{causes:?}");
    let (again, ran) = run(&farm, Policy::default());
    assert_eq!((again.failed, again.already, ran.len()), (summary.failed, 1, 0), "failed rows are not tried again");
    let retry = Policy { retry_failed: true, ..Policy::default() };
    let (_, ran) = run(&farm, retry);
    assert_eq!(ids(&ran), ["bad", "poor"], "unless it is asked for, and then once");
    assert_eq!(ran[1].1, Attempt { number: 2, replaces: true, goes_on: false });
    let journal = Journal::open(&farm.manifest().state(), "reader").expect("readable");
    let record = journal.last("bad").expect("a record");
    assert_eq!((record.state, record.exit_code, record.attempt), (State::Failed, Some(66), 2));
    let lines = records(&farm);
    let noted = lines.iter().find(|record| record.id == "bad").expect("a record");
    assert_eq!(noted.notes["does"], "fail", "columns that the job does not know");
}

#[test]
fn too_many_failures_end_the_run() {
    let farm = Farm::new(&["id,job,input,output,does", "a,copy,x,1,fail", "b,copy,x,2,fail", "c,copy,x,3,"]);
    farm.put("x", "1");
    let (summary, ran) = run(&farm, Policy { max_failures: Some(2), ..Policy::default() });
    assert_eq!((summary.failed.len(), summary.left, ids(&ran)), (2, 1, vec!["a", "b"]));
}

#[test]
fn what_no_row_made_is_not_replaced() {
    let farm = Farm::new(&["id,job,input,output", "a,copy,x,a.out"]);
    farm.put("x", "1");
    farm.put("a.out", "somebody's work");
    let (summary, ran) = run(&farm, Policy::default());
    assert!(ran.is_empty() && summary.failed[0].1.contains("--overwrite"), "{summary:?}");
    assert_eq!(fs::read(farm.at("a.out")).expect("there"), b"somebody's work");
    let (summary, _) = run(&farm, Policy { replace: true, retry_failed: true, ..Policy::default() });
    assert_eq!((summary.done, fs::read(farm.at("a.out")).expect("made")), (1, b"1".to_vec()));
}

#[test]
fn a_lost_device_is_opened_anew_once() {
    let farm = Farm::new(&[
        "id,job,input,output,does,cost",
        "once,copy,x,1,lose the device,2",
        "always,copy,x,2,lose every device,1",
    ]);
    farm.put("x", "1");
    let (summary, ran) = run(&farm, Policy::default());
    assert_eq!((summary.done, ids(&ran)), (1, vec!["once", "once", "always", "always"]));
    let journal = Journal::open(&farm.manifest().state(), "reader").expect("readable");
    assert_eq!(journal.last("always").and_then(|record| record.exit_code), Some(76));
}

#[test]
fn what_was_broken_off_is_gone_on_with() {
    let farm = Farm::new(&["id,job,input,output,does", "a,copy,x,1,stop", "b,copy,x,2,"]);
    farm.put("x", "1");
    let (summary, ran) = run(&farm, Policy::default());
    assert!(summary.is_interrupted && summary.left == 2 && ran.len() == 1, "{summary:?}");
    let (_, ran) = run(&farm, Policy::default());
    assert_eq!(ran[0].1, Attempt { number: 2, replaces: true, goes_on: true }, "asked to stop");

    // Killed: it was begun, its output is there, and nobody wrote that it is done.
    let farm = Farm::new(&["id,job,input,output", "a,copy,x,1"]);
    farm.put("x", "new");
    farm.put("1", "old");
    let manifest = farm.manifest();
    let begun = Record::begun("a", "copy", 1, manifest.rows()[0].settings_hash(), "killed");
    Journal::open(&manifest.state(), "killed").expect("readable").add(&[begun]).expect("writable");
    let (summary, ran) = run(&farm, Policy::default());
    assert_eq!((summary.done, ran[0].1), (1, Attempt { number: 2, replaces: true, goes_on: true }));
    assert_eq!(fs::read(farm.at("1")).expect("made"), b"new");
}

#[test]
fn light_rows_are_done_several_at_once_and_recorded_each() {
    let light: Vec<String> =
        (0..11).map(|n| format!("l{n},copy,x,{n}.out,yes,{}", if n == 3 { "fail" } else { "" })).collect();
    let mut lines = vec!["id,job,input,output,light,does", "heavy,copy,x,h.out,,", "reads,copy,10.out,r.out,yes,"];
    lines.extend(light.iter().map(String::as_str));
    let farm = Farm::new(&lines);
    farm.put("x", "1");
    let mut jobs = Copying { folder: farm.folder.path().to_path_buf(), ..Copying::default() };
    let summary = run_with(&farm.manifest(), Policy::default(), &mut jobs);
    assert_eq!((summary.done, summary.failed.len(), summary.left), (12, 1, 0), "one that fails stops no other");
    assert_eq!(jobs.at_once, [8, 3], "of eleven; the one that reads another's output comes alone, after it");
    assert_eq!(fs::read(farm.at("r.out")).expect("made"), b"1");
    let records = records(&farm);
    for id in ["heavy", "reads", "l0", "l10"] {
        let states: Vec<State> = records.iter().filter(|record| record.id == id).map(|record| record.state).collect();
        assert_eq!(states, [State::Running, State::Done], "{id}");
    }
    assert_eq!(names(&farm.manifest().state().join("claims")), Vec::<String>::new(), "no claim is left");

    // Asked to stop in the middle of several.
    let farm = Farm::new(&["id,job,input,output,light,does", "a,copy,x,1,yes,", "b,copy,x,2,yes,stop", "c,copy,x,3,,"]);
    farm.put("x", "1");
    let (summary, _) = run(&farm, Policy::default());
    assert_eq!((summary.done, summary.left, summary.is_interrupted), (2, 1, true), "{summary:?}");
}

#[test]
fn rows_with_devices_of_their_own_are_done_at_once_where_it_is_asked_for() {
    let farm = Farm::new(&[
        "id,job,input,output,does,light",
        "a,copy,x,1,,",
        "b,copy,x,2,lose the device,",
        "l,copy,x,3,,yes",
        "c,copy,x,4,,",
    ]);
    farm.put("x", "1");
    let mut jobs = Copying { folder: farm.folder.path().to_path_buf(), ..Copying::default() };
    let summary = run_with(&farm.manifest(), Policy { at_once: NonZeroUsize::new(2), ..Policy::default() }, &mut jobs);
    assert_eq!((summary.done, summary.failed), (4, vec![]));
    assert_eq!(jobs.at_once, [2], "two that need a device, and no light row among them");
    assert_eq!(ids(&jobs.ran), ["a", "b", "b", "l", "c"], "the one that lost its device was done again, alone");
}

#[test]
fn rows_share_a_device_once_one_was_measured_and_memory_holds_them() {
    let farm = Farm::new(&["id,job,input,output", "a,copy,x,1", "b,copy,x,2", "c,copy,x,3", "d,other,x,4"]);
    farm.put("x", "1");
    let at_once = |free| {
        let memory = Some(DeviceMemory { free, held: 5, row_peak: 10 });
        let mut jobs = Copying { folder: farm.folder.path().to_path_buf(), memory, ..Copying::default() };
        let policy = Policy { replace: true, ..Policy::default() };
        fs::remove_dir_all(farm.manifest().state()).ok();
        assert_eq!(run_with(&farm.manifest(), policy, &mut jobs).done, 4);
        assert_eq!(ids(&jobs.ran), ["a", "b", "c", "d"]);
        jobs.at_once
    };
    assert_eq!(at_once(14), [] as [usize; 0], "memory for one and nine tenths");
    let two = if std::thread::available_parallelism().is_ok_and(|all| all.get() > 1) { vec![2] } else { vec![] };
    assert_eq!(at_once(15), two, "the first alone, then two, and the first of another job alone");
}

#[test]
fn workers_at_once_do_every_row_once() {
    let rows: Vec<String> = (0..60)
        .map(|n| format!("r{n},copy,{},{n}.out", if n < 20 { "x".to_owned() } else { format!("{}.out", n - 20) }))
        .collect();
    let lines: Vec<&str> = std::iter::once("id,job,input,output").chain(rows.iter().map(String::as_str)).collect();
    let farm = Farm::new(&lines);
    farm.put("x", "1");
    let (manifest, all) = (farm.manifest(), Mutex::new(Vec::new()));
    let folder = farm.folder.path();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let mut jobs = Copying { folder: folder.to_path_buf(), all: Some(&all), ..Copying::default() };
                let summary = run_with(&manifest, Policy::default(), &mut jobs);
                assert_eq!(summary.failed, []);
            });
        }
    });
    let mut ran = all.into_inner().expect("no test panics in it");
    ran.sort();
    let mut expected: Vec<String> = (0..60).map(|n| format!("r{n}")).collect();
    expected.sort();
    assert_eq!(ran, expected, "each once");
    let (summary, ran) = run(&farm, Policy::default());
    assert_eq!((summary.already, ran.len()), (60, 0), "and all are done");
}
