//! Claims: one worker at a time, given up when dropped, taken over when its worker is silent.

use std::fs::{self, File};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, SystemTime};

use guard4d_engine::farm::claim::{BEAT, Claims, worker_name};

use crate::support::names;

#[test]
fn a_row_is_one_workers_until_it_lets_go() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let open = |name: &str| Claims::open(folder.path(), name, BEAT).expect("writable");
    let (one, other) = (open("one"), open("other"));
    let held = one.take("row").expect("readable").expect("free");
    assert!(other.take("row").expect("readable").is_none(), "it is taken");
    assert!(other.take("another").expect("readable").is_some(), "others are free");
    drop(held);
    assert!(other.take("row").expect("readable").is_some(), "it is free again");
    drop((one, other));
    assert_eq!(names(folder.path()), Vec::<String>::new(), "nothing is left");
}

#[test]
fn a_silent_workers_row_is_taken_over_and_a_living_ones_is_not() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let claim = folder.path().join("row");
    // A worker that was killed: its claim is there, and nobody writes it.
    fs::write(&claim, "gone").expect("writable");
    let other = Claims::open(folder.path(), "other", BEAT).expect("writable");
    assert!(other.take("row").expect("readable").is_none(), "it may be alive");
    // Three beats of 20 seconds, and one more.
    let long_ago = SystemTime::now() - Duration::from_secs(80);
    File::options().write(true).open(&claim).and_then(|file| file.set_modified(long_ago)).expect("writable");
    let taken = other.take("row").expect("readable").expect("its worker is silent");
    assert_eq!(fs::read_to_string(&claim).expect("readable"), "other");
    drop(taken);
    assert!(!claim.exists(), "and let go");

    // One that says every 20 ms that it is there keeps its row for longer than three beats of whoever wants it.
    let beat = Duration::from_millis(20);
    let alive = Claims::open(folder.path(), "alive", beat).expect("writable");
    let watcher = Claims::open(folder.path(), "watcher", Duration::from_secs(1)).expect("writable");
    let held = alive.take("row").expect("readable").expect("free");
    std::thread::sleep(Duration::from_millis(3500));
    assert!(watcher.take("row").expect("readable").is_none(), "it is alive");
    drop(held);
}

#[test]
fn of_many_that_ask_at_once_one_gets_it() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let claim = folder.path().join("row");
    fs::write(&claim, "gone").expect("writable");
    let long_ago = SystemTime::now() - Duration::from_secs(80);
    File::options().write(true).open(&claim).and_then(|file| file.set_modified(long_ago)).expect("writable");
    let (winners, barrier) = (AtomicUsize::new(0), std::sync::Barrier::new(8));
    let workers: Vec<Arc<Claims>> =
        (0..8).map(|n| Claims::open(folder.path(), &format!("w{n}"), BEAT).expect("writable")).collect();
    std::thread::scope(|scope| {
        for worker in &workers {
            scope.spawn(|| {
                barrier.wait();
                let held = worker.take("row").expect("readable");
                winners.fetch_add(usize::from(held.is_some()), Ordering::SeqCst);
                barrier.wait();
            });
        }
    });
    assert_eq!(winners.load(Ordering::SeqCst), 1, "a claim that was nobody's");
}

#[test]
fn a_dead_workers_row_is_free_at_once() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let me = worker_name().expect("random numbers");
    // This machine, and a process that it cannot have: numbers end at 2^22 (proc(5), pid_max).
    let dead = me.replace(&format!("-{}-", std::process::id()), "-4194305-");
    let elsewhere = dead.replacen(me.split('-').next().expect("a host"), "elsewhere", 1);
    for (row, worker) in [("row", &dead), (".left", &dead), ("far", &elsewhere)] {
        fs::write(folder.path().join(row), worker).expect("writable");
    }
    fs::write(folder.path().join(format!(".{dead}")), "").expect("writable");
    let claims = Claims::open(folder.path(), &me, BEAT).expect("writable");
    let left = names(folder.path()).into_iter().filter(|name| name.contains("left") || name.contains("4194305"));
    assert_eq!(left.collect::<Vec<_>>(), Vec::<String>::new(), "what it left is removed");
    fs::write(folder.path().join("later"), &dead).expect("writable");
    for row in ["row", "later"] {
        assert!(claims.take(row).expect("readable").is_some(), "{row}: its worker is dead");
    }
    assert!(claims.take("far").expect("readable").is_none(), "of a worker elsewhere this machine knows nothing");
    let alive = Claims::open(folder.path(), "other", BEAT).expect("writable");
    let held = claims.take("mine").expect("readable").expect("free");
    assert!(alive.take("mine").expect("readable").is_none(), "this process is alive");
    drop(held);
}
