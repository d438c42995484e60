//! Records: what holds of several, what other workers add, and lines that were cut off.

use std::fs::{self, OpenOptions};
use std::io::Write as _;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::farm::journal::Journal;
use guard4d_engine::farm::record::{Record, State};

fn record(id: &str, attempt: u32, state: State) -> Record {
    Record { state, ..Record::begun(id, "render", attempt, Digest::of(b"settings"), "one") }
}

#[test]
fn the_last_attempt_holds_and_of_one_attempt_how_it_ended() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let open = |name: &str| Journal::open(folder.path(), name).expect("readable");
    let (mut one, mut other) = (open("one"), open("other"));
    one.add(&[record("a", 1, State::Running)]).expect("writable");
    one.add(&[record("a", 1, State::Failed)]).expect("writable");
    assert!(other.last("a").is_none(), "not read yet");
    other.refresh().expect("readable");
    assert_eq!(other.last("a").map(|record| record.state), Some(State::Failed));
    other.add(&[record("a", 2, State::Running)]).expect("writable");
    one.refresh().expect("readable");
    assert_eq!(one.last("a").map(|record| (record.attempt, record.state)), Some((2, State::Running)));
    // Whatever the order of files and lines.
    one.add(&[record("a", 1, State::Done)]).expect("writable");
    for journal in [&one, &open("third")] {
        assert_eq!(journal.last("a").map(|record| record.attempt), Some(2));
    }
}

#[test]
fn a_line_that_was_cut_off_is_none_and_another_is_an_error() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let mut journal = Journal::open(folder.path(), "one").expect("readable");
    journal.add(&[record("a", 1, State::Done)]).expect("writable");
    let line = fs::read(folder.path().join("one.jsonl")).expect("readable");
    let cut = folder.path().join("cut.jsonl");
    fs::write(&cut, &line[..line.len() / 2]).expect("writable");
    let mut reader = Journal::open(folder.path(), "two").expect("half a line is none");
    assert!(reader.last("a").is_some(), "whole lines hold");
    // It was being written: the rest comes later.
    let mut file = OpenOptions::new().append(true).open(&cut).expect("writable");
    file.write_all(&line[line.len() / 2..]).expect("writable");
    reader.refresh().expect("readable");
    for (bad, word) in [("{\"id\":1}\n", "line"), ("not JSON\n", "line")] {
        fs::write(folder.path().join("bad.jsonl"), bad).expect("writable");
        let error = Journal::open(folder.path(), "two").expect_err("no record").to_string();
        assert!(error.contains("bad.jsonl") && error.contains(word), "{error}");
    }
    let other = String::from_utf8(line).expect("UTF-8").replace("guard4d.farm-record/1", "guard4d.farm-record/9");
    fs::write(folder.path().join("bad.jsonl"), other).expect("writable");
    let error = Journal::open(folder.path(), "two").expect_err("of a later version").to_string();
    assert!(error.contains("guard4d.farm-record/9"), "{error}");
}
