//! The ledger: each attempt once, however often it is made, and the same from all records at once.

use std::fs;

use guard4d_engine::farm::journal::Journal;
use guard4d_engine::farm::ledger::{JobFigures, Ledger, Mark};
use guard4d_engine::farm::manifest::Manifest;
use guard4d_engine::farm::record::{Record, State};
use serde_json::json;

use super::Farm;

fn record(manifest: &Manifest, place: usize, attempt: u32, state: State, seconds: f64) -> Record {
    let row = &manifest.rows()[place];
    let begun = Record::begun(&row.id, &row.job, attempt, row.settings_hash(), "one");
    let ended_unix_s = (state != State::Running).then_some(1000.0 + seconds);
    Record { state, seconds, ended_unix_s, ..begun }
}

fn farm() -> Farm {
    Farm::new(&["id,job,input,output", "a,embed,x,out/a", "b,embed,x,out/b", "c,render,x,c.mp4", "d,render,x,d.mp4"])
}

#[test]
fn attempts_are_merged_once_and_those_that_hold_are_told() {
    let farm = farm();
    let manifest = farm.manifest();
    let none = Ledger::merge(&manifest).expect("nothing is written down yet");
    assert!(none.jobs().expect("whole").is_empty() && none.spans().expect("whole").is_empty());
    let mut one = Journal::open(&manifest.state(), "one").expect("readable");
    let mut other = Journal::open(&manifest.state(), "other").expect("readable");
    let marked = |marked: f64| json!({ "marked": marked, "psnr": { "mean_of_views_db": 48.5 } });
    let mut say = |record: Record| one.add(&[record]).expect("writable");
    say(record(&manifest, 0, 1, State::Running, 0.0));
    say(record(&manifest, 0, 1, State::Failed, 5.0));
    say(Record { result: marked(0.9), ..record(&manifest, 0, 2, State::Done, 7.0) });
    say(record(&manifest, 2, 1, State::Done, 2.0));
    Ledger::merge(&manifest).expect("readable");
    // What came later, by another worker.
    let later = Record { result: marked(0.75), ..record(&manifest, 1, 1, State::Done, 9.0) };
    other.add(&[record(&manifest, 1, 1, State::Running, 0.0), later]).expect("writable");
    other.add(&[record(&manifest, 3, 1, State::Done, 4.0)]).expect("writable");
    let ledger = Ledger::merge(&manifest).expect("readable");
    let figures =
        |job: &str, seconds, median_s, most_s| JobFigures { job: job.to_owned(), done: 2, seconds, median_s, most_s };
    assert_eq!(ledger.jobs().expect("whole"), [figures("embed", 16.0, 9.0, 9.0), figures("render", 6.0, 4.0, 4.0)]);
    let mark = |id: &str, bit_accuracy, seconds| Mark {
        id: id.to_owned(),
        output: format!("out/{id}"),
        bit_accuracy,
        psnr_db: Some(48.5),
        seconds,
    };
    assert_eq!(ledger.marks(&manifest).expect("whole"), [mark("b", 0.75, 9.0), mark("a", 0.9, 7.0)], "the worst first");
    let spans = ledger.spans().expect("whole");
    let ids: Vec<(&str, bool)> = spans.iter().map(|span| (span.id.as_str(), span.is_done)).collect();
    assert_eq!(ids, [("c", true), ("d", true), ("a", false), ("a", true), ("b", true)], "by their ends");
    let csv = String::from_utf8(ledger.csv().expect("whole")).expect("text");
    assert_eq!(csv.lines().count(), 5, "a head, and a line for each row: {csv}");
    assert!(csv.contains("\na,embed,done,2,,7,,one,{}\n"), "{csv}");
    // Made at once of all records it says the same.
    fs::remove_file(ledger.path()).expect("there");
    let anew = Ledger::merge(&manifest).expect("readable");
    assert_eq!((anew.csv().expect("whole"), anew.spans().expect("whole")), (csv.into_bytes(), spans));
}

#[test]
fn records_are_read_from_where_the_ledger_ends() {
    let farm = farm();
    let manifest = farm.manifest();
    let mut one = Journal::open(&manifest.state(), "one").expect("readable");
    let result = json!({ "peak_memory_bytes": 4096 });
    one.add(&[Record { result, ..record(&manifest, 0, 1, State::Done, 5.0) }]).expect("writable");
    one.add(&[record(&manifest, 1, 1, State::Failed, 1.0)]).expect("writable");
    let alone = Journal::open(&manifest.state(), "two").expect("readable");
    Ledger::merge(&manifest).expect("readable");
    let file = manifest.state().join("one.jsonl");
    // Lines that the ledger has are not looked at again, so that what is wrong in them is not seen.
    let lines = fs::read(&file).expect("readable");
    fs::write(&file, vec![b'x'; lines.len() - 1].into_iter().chain([b'\n']).collect::<Vec<u8>>()).expect("writable");
    let merged = Journal::open(&manifest.state(), "two").expect("the ledger says it");
    for id in ["a", "b"] {
        assert!(merged.last(id).is_some() && merged.last(id) == alone.last(id), "{id} as the records say it");
    }
    // What came later stands behind it.
    fs::write(&file, &lines).expect("writable");
    one.add(&[record(&manifest, 1, 2, State::Done, 3.0)]).expect("writable");
    let later = Journal::open(&manifest.state(), "two").expect("readable");
    assert_eq!(later.last("b").map(|known| (known.attempt, known.state)), Some((2, State::Done)));
    // A file that is shorter now is another one, and a ledger that cannot be read is left aside.
    fs::remove_file(&file).expect("there");
    let mut other = Journal::open(&manifest.state(), "one").expect("readable");
    other.add(&[record(&manifest, 2, 1, State::Done, 2.0)]).expect("writable");
    let other = Journal::open(&manifest.state(), "two").expect("readable");
    assert!(other.last("a").is_some() && other.last("c").is_some(), "the ledger's and the new file's");
    assert!(Ledger::merge(&manifest).expect("readable").csv().expect("whole").len() > 100, "here, too");
    fs::write(Ledger::path_of(&manifest), "no database at all, but long enough to be taken for one").expect("writable");
    let without = Journal::open(&manifest.state(), "two").expect("records say it");
    assert!(without.last("a").is_none() && without.last("c").is_some(), "what the records say");
}

#[test]
fn a_ledger_of_an_older_version_is_made_again() {
    let farm = farm();
    let manifest = farm.manifest();
    let mut one = Journal::open(&manifest.state(), "one").expect("readable");
    one.add(&[record(&manifest, 0, 1, State::Done, 5.0)]).expect("writable");
    let path = Ledger::merge(&manifest).expect("readable").path().to_path_buf();
    // SQLite's user_version, in the header.
    let mut bytes = fs::read(&path).expect("there");
    bytes[60..64].copy_from_slice(&1u32.to_be_bytes());
    fs::write(&path, &bytes).expect("writable");
    assert!(Ledger::open(&path).expect_err("older").to_string().contains("user_version"), "not read as it is");
    let ledger = Ledger::merge(&manifest).expect("made again");
    assert_eq!(ledger.jobs().expect("whole").len(), 1, "of all records");
    bytes[60..64].copy_from_slice(&99u32.to_be_bytes());
    fs::write(&path, &bytes).expect("writable");
    Ledger::merge(&manifest).expect_err("a later version is not thrown away");
}

#[test]
fn another_database_is_refused_and_left_as_it_is() {
    let farm = farm();
    let manifest = farm.manifest();
    let path = Ledger::path_of(&manifest);
    assert!(Ledger::open(&path).expect_err("there is none").to_string().contains("ledger"));
    fs::create_dir_all(manifest.state()).expect("writable");
    let bytes = b"no database at all, but long enough to be taken for one";
    fs::write(&path, bytes).expect("writable");
    let error = Ledger::merge(&manifest).expect_err("no ledger").to_string();
    assert!(error.contains("ledger.sqlite") && error.contains("made again"), "{error}");
    assert_eq!(fs::read(&path).expect("there"), bytes, "as it was");
    fs::remove_file(&path).expect("there");
    fs::write(manifest.state().join("bad.jsonl"), "{\"id\":1}\n").expect("writable");
    let error = Ledger::merge(&manifest).expect_err("no records").to_string();
    assert!(error.contains("bad.jsonl"), "{error}");
    assert!(!path.exists(), "half a ledger is none");
}
