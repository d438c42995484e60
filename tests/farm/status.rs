//! Status: rows by what their records say of the settings that they have now.

use std::collections::BTreeMap;

use guard4d_engine::farm::journal::Journal;
use guard4d_engine::farm::record::{Record, State};
use guard4d_engine::farm::status::{Failure, Status};

use super::Farm;

#[test]
fn rows_are_counted_by_what_became_of_them() {
    let farm = Farm::new(&[
        "id,job,input,output",
        "done,render,x,1",
        "slow,render,x,2",
        "failed,render,x,3",
        "running,render,x,4",
        "stopped,embed,x,5",
        "new,render,x,6",
        "changed,render,x,7",
    ]);
    let manifest = farm.manifest();
    let none = Status::of(&manifest).expect("readable");
    assert_eq!((none.rows, none.pending, none.seconds_left), (7, 7, None), "nothing is known yet");
    let mut journal = Journal::open(&manifest.state(), "one").expect("readable");
    let mut say = |id: &str, state, seconds, exit_code: Option<u8>| {
        let row = manifest.rows().iter().find(|row| row.id == id).expect("a row");
        let settings = if id == "changed" { manifest.rows()[0].settings_hash() } else { row.settings_hash() };
        let error = exit_code.map(|_| "no such file".to_owned());
        let begun = Record::begun(id, &row.job, 1, settings, "one");
        journal.add(&[Record { state, seconds, exit_code, error, ..begun }]).expect("writable");
    };
    say("done", State::Done, 2.0, None);
    say("slow", State::Done, 4.0, None);
    say("failed", State::Failed, 1.0, Some(66));
    say("running", State::Running, 0.0, None);
    say("stopped", State::Interrupted, 9.0, None);
    say("changed", State::Done, 1.0, None);
    let status = Status::of(&manifest).expect("readable");
    let Status { done, failed, running, interrupted, pending, .. } = status;
    assert_eq!((done, failed, running, interrupted, pending), (2, 1, 1, 1, 2));
    assert_eq!(
        (status.seconds, status.seconds_left),
        (6.0, None),
        "no embed is done that would say how long one takes"
    );
    assert_eq!(status.slowest.iter().map(|slow| slow.id.as_str()).collect::<Vec<_>>(), ["slow", "done"]);
    assert_eq!(status.failures[&66][0].error, "no such file");
    let row = &manifest.rows()[4];
    let begun = Record::begun("stopped", "embed", 2, row.settings_hash(), "one");
    journal.add(&[Record { state: State::Done, seconds: 50.0, ..begun }]).expect("writable");
    let status = Status::of(&manifest).expect("readable");
    assert_eq!(status.seconds_left, Some(9.0), "three renders are left, of three seconds each");
}

#[test]
fn a_monitor_reads_the_same_numbers() {
    let failure = Failure { id: "a".to_owned(), error: "no such file".to_owned() };
    let status = Status {
        rows: 5,
        done: 2,
        failed: 1,
        pending: 2,
        seconds: 6.5,
        failures: BTreeMap::from([(66, vec![failure])]),
        ..Status::default()
    };
    let text = status.prometheus("a \"quoted\" farm.csv");
    let has = |line: &str| assert!(text.lines().any(|l| l == line), "{line} in\n{text}");
    has("# TYPE guard4d_farm_rows gauge");
    has(r#"guard4d_farm_rows{manifest="a \"quoted\" farm.csv",state="done"} 2"#);
    has(r#"guard4d_farm_rows{manifest="a \"quoted\" farm.csv",state="running"} 0"#);
    has(r#"guard4d_farm_failed_rows{manifest="a \"quoted\" farm.csv",exit_code="66"} 1"#);
    has(r#"guard4d_farm_work_seconds{manifest="a \"quoted\" farm.csv"} 6.5"#);
    assert!(!text.contains("work_left"), "what is not known is not there");
    let known = Status { seconds_left: Some(3.0), ..status };
    assert!(known.prometheus("farm.csv").contains("guard4d_farm_work_left_seconds{manifest=\"farm.csv\"} 3\n"));
}
