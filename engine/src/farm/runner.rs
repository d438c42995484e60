//! Doing rows in one process: one after the other, and light ones several at once.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};

use guard4d_kernels::KernelError;
use serde_json::Value;

use super::ahead::Ahead;
use super::claim::{BEAT, Claim, Claims, worker_name};
use super::contents::Contents;
use super::crowd::{Crowd, DeviceMemory};
use super::journal::Journal;
use super::manifest::{Manifest, Row};
use super::record::{Record, State};
use crate::base::checkpoint;
use crate::base::digest::Digest;
use crate::base::output::remove_partials;
use crate::error::EngineError;

/// How long to wait for other workers before looking again.
const PATIENCE: Duration = Duration::from_secs(1);
/// Most light rows that are done at once. They wait for the disk more than for a processor.
const AT_ONCE: usize = 8;

/// What does the rows' jobs.
pub trait Jobs {
    /// Does a row.
    ///
    /// # Errors
    /// What made it fail; [`EngineError::Interrupted`] and [`EngineError::Stopped`] when it was asked to stop.
    fn run(&mut self, row: &Row, attempt: Attempt) -> Result<Ended, EngineError>;

    /// Whether a row needs neither a device nor much memory, so that several of its kind may be done at once.
    fn is_light(&self, _row: &Row) -> bool {
        false
    }

    /// Does rows at once, either light ones or such that need a device each; what each came to, in their order.
    fn run_at_once(&mut self, rows: &[(&Row, Attempt)]) -> Vec<Result<Ended, EngineError>> {
        rows.iter().map(|(row, attempt)| self.run(row, *attempt)).collect()
    }

    /// Memory of the device that rows are done on, if there is one and the driver tells.
    fn device_memory(&self) -> Option<DeviceMemory> {
        None
    }

    /// Columns of a row that its job does not know.
    fn notes(&self, row: &Row) -> BTreeMap<String, String>;

    /// Forgets a device that was lost, so that the next row opens it anew.
    fn forget_device(&mut self);

    /// Whether the process was asked to stop.
    fn is_stopped(&self) -> bool;
}

/// What an attempt may build on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Attempt {
    /// From 1.
    pub number: u32,
    /// The output may be replaced: an earlier attempt at this row left it, or it was asked for.
    pub replaces: bool,
    /// The attempt before was at the same, and broke off: what it left to go on from fits.
    pub goes_on: bool,
}

/// How a row ended without an error.
#[derive(Clone, Debug, PartialEq)]
pub struct Ended {
    /// As if it were a command of its own.
    pub exit_code: u8,
    /// Why the result is not good enough, if it is not.
    pub shortfall: Option<String>,
    /// What the command prints with `--json`.
    pub result: Value,
}

/// What is done about rows that are not new.
#[derive(Clone, Copy, Debug, Default)]
pub struct Policy {
    /// Rows that failed are tried again.
    pub retry_failed: bool,
    /// Outputs that no row of this manifest made may be replaced.
    pub replace: bool,
    /// After as many failures no other row is begun.
    pub max_failures: Option<usize>,
    /// How many rows are done at once that are not light; by default as many as measures faster, if the memory of the
    /// device holds them.
    pub at_once: Option<NonZeroUsize>,
}

/// What a worker achieved.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Summary {
    /// Rows that it did.
    pub done: usize,
    /// Rows that were done before.
    pub already: usize,
    /// Rows that failed, now or before, with their causes.
    pub failed: Vec<(String, String)>,
    /// Rows that another worker does.
    pub elsewhere: usize,
    /// Rows that were not begun, because it was asked to stop or too many had failed.
    pub left: usize,
    /// Whether it was asked to stop.
    pub is_interrupted: bool,
}

/// What happened to a row, for whoever watches.
#[derive(Clone, Copy, Debug)]
pub enum Event<'a> {
    /// It is begun.
    Begins(&'a Row),
    /// It ended as this record says.
    Ends(&'a Row, &'a Record),
    /// It is not begun: it is done already, or another worker has it, or what it needs has failed.
    Passes(&'a Row),
}

/// One process that does rows.
pub struct Worker<'a> {
    manifest: &'a Manifest,
    policy: Policy,
    journal: Journal,
    claims: Arc<Claims>,
    name: String,
    jobs: &'a mut dyn Jobs,
    watch: &'a mut dyn FnMut(Event<'_>),
    ahead: Ahead,
    crowd: Crowd,
    /// Rows that are known to be done.
    done: HashSet<usize>,
    /// Rows that failed while this worker was there, and why.
    failed: HashMap<usize, String>,
}

/// What one look at a row came to.
enum Looked {
    Did,
    Already,
    Failed(String),
    Elsewhere,
    /// What it needs is not there yet.
    Waits,
    Stopped,
}

impl Summary {
    /// Counts how a row ended.
    fn count(&mut self, row: &Row, looked: Looked) {
        match looked {
            Looked::Did => self.done += 1,
            Looked::Already => self.already += 1,
            Looked::Failed(why) => self.failed.push((row.id.clone(), why)),
            Looked::Elsewhere => self.elsewhere += 1,
            Looked::Waits => {}
            Looked::Stopped => {
                self.is_interrupted = true;
                self.left += 1;
            }
        }
    }
}

/// What is to be done about a row.
enum Considered {
    /// Nothing.
    Over(Looked),
    /// Nothing more: it was refused, and that is written down.
    Refused(Looked),
    /// It can be begun.
    Ready(Box<Begun>),
}

/// A row that this worker begins.
struct Begun {
    place: usize,
    attempt: Attempt,
    record: Record,
    /// Kept until it is written down how the row ended.
    claim: Claim,
}

impl<'a> Worker<'a> {
    /// Opens the records of a manifest.
    ///
    /// # Errors
    /// Those of [`Journal::open`] and [`Claims::open`].
    pub fn new(
        manifest: &'a Manifest,
        policy: Policy,
        jobs: &'a mut dyn Jobs,
        watch: &'a mut dyn FnMut(Event<'_>),
    ) -> Result<Self, EngineError> {
        let (state, name) = (manifest.state(), worker_name()?);
        let claims = Claims::open(&state.join("claims"), &name, BEAT)?;
        let journal = Journal::open(&state, &name)?;
        let (ahead, crowd, done, failed) = (Ahead::default(), Crowd::default(), HashSet::new(), HashMap::new());
        Ok(Self { manifest, policy, journal, claims, name, jobs, watch, ahead, crowd, done, failed })
    }

    /// Does these rows, which stand behind all that they need.
    ///
    /// # Errors
    /// [`EngineError::Io`] and the like about the records. What fails in a row is part of the summary.
    pub fn run(&mut self, places: &[usize]) -> Result<Summary, EngineError> {
        let needed: HashSet<usize> =
            places.iter().flat_map(|place| self.manifest.rows()[*place].needs.clone()).collect();
        let mut summary = Summary::default();
        let mut left = places.to_vec();
        loop {
            // What is needed is looked at again: its worker may fall silent.
            let again = self.pass(&left, &needed, &mut summary)?;
            if summary.left > 0 || again.is_empty() {
                return Ok(summary);
            }
            if again.len() == left.len() {
                std::thread::sleep(PATIENCE);
            }
            self.journal.refresh()?;
            left = again;
        }
    }

    /// Goes through these rows once; which of them are to be looked at again. None where the run ends here: the summary
    /// counts what is left then.
    fn pass(
        &mut self,
        left: &[usize],
        needed: &HashSet<usize>,
        summary: &mut Summary,
    ) -> Result<Vec<usize>, EngineError> {
        let (mut again, mut begun, mut rest) = (Vec::new(), Vec::new(), 0);
        // Jobs are not mixed, nor light rows with others.
        let mut kind = None;
        let manifest = self.manifest;
        for (nth, &place) in left.iter().enumerate() {
            let is_enough = self.policy.max_failures.is_some_and(|most| summary.failed.len() >= most);
            if self.jobs.is_stopped() || is_enough || summary.is_interrupted {
                summary.is_interrupted |= self.jobs.is_stopped();
                rest = left.len() - nth;
                break;
            }
            let row = &manifest.rows()[place];
            let is_light = self.jobs.is_light(row);
            if kind.replace((is_light, &row.job)) != Some((is_light, &row.job)) {
                self.attempt(std::mem::take(&mut begun), summary)?;
            }
            match self.consider(place)? {
                Considered::Over(Looked::Elsewhere) if needed.contains(&place) => again.push(place),
                Considered::Over(Looked::Waits) => again.push(place),
                Considered::Over(looked) => {
                    (self.watch)(Event::Passes(row));
                    summary.count(row, looked);
                }
                Considered::Refused(looked) => summary.count(row, looked),
                Considered::Ready(ready) => {
                    begun.push(*ready);
                    let most = if is_light { AT_ONCE } else { self.at_once(&row.job) };
                    if begun.len() >= most {
                        self.look_ahead(left[nth + 1..].iter().take(most));
                        self.attempt(std::mem::take(&mut begun), summary)?;
                    }
                }
            }
        }
        self.attempt(begun, summary)?;
        if summary.is_interrupted || rest > 0 {
            summary.left += rest + again.len();
        }
        Ok(again)
    }

    /// How many rows of a job are done at once.
    fn at_once(&self, job: &str) -> usize {
        self.policy.at_once.map_or_else(|| self.crowd.most(job, self.jobs.device_memory()), NonZeroUsize::get)
    }

    /// Has the inputs of rows read whose turn comes next.
    fn look_ahead<'p>(&self, next: impl Iterator<Item = &'p usize>) {
        let rows = next.map(|place| &self.manifest.rows()[*place]);
        let is_done = |row: &&Row| self.journal.last(&row.id).is_some_and(|last| last.state == State::Done);
        let wanted = rows.filter(|row| !row.input.is_empty() && !is_done(row));
        wanted.for_each(|row| self.ahead.ask(&self.at(&row.input)));
    }

    /// Takes a row, unless it is done, waits, or is another's.
    fn consider(&mut self, place: usize) -> Result<Considered, EngineError> {
        let row = &self.manifest.rows()[place];
        if self.is_done(place)? {
            return Ok(Considered::Over(Looked::Already));
        }
        if let Some(why) = self.failure(place) {
            return Ok(Considered::Over(Looked::Failed(why)));
        }
        for &need in &row.needs {
            if self.failure(need).is_some() {
                let why = format!("it needs `{}`, which failed", self.manifest.rows()[need].id);
                self.failed.insert(place, why.clone());
                return Ok(Considered::Over(Looked::Failed(why)));
            }
            if !self.is_done(need)? {
                return Ok(Considered::Over(Looked::Waits));
            }
        }
        let Some(claim) = self.claims.take(&row.id)? else { return Ok(Considered::Over(Looked::Elsewhere)) };
        // Who had it before may have done it.
        self.journal.refresh()?;
        if self.is_done(place)? { Ok(Considered::Over(Looked::Already)) } else { self.begin(place, claim) }
    }

    /// Why a row failed that is not to be tried again.
    fn failure(&self, place: usize) -> Option<String> {
        if let Some(why) = self.failed.get(&place) {
            return Some(why.clone());
        }
        let row = &self.manifest.rows()[place];
        let last = self.journal.last(&row.id).filter(|_| !self.policy.retry_failed)?;
        let holds = last.state == State::Failed && last.settings == row.settings_hash();
        holds.then(|| last.error.clone().unwrap_or_default())
    }

    /// Whether a row is done: of the same settings and input, with all that it made still there.
    fn is_done(&mut self, place: usize) -> Result<bool, EngineError> {
        if self.done.contains(&place) {
            return Ok(true);
        }
        let row = &self.manifest.rows()[place];
        let Some(last) = self.journal.last(&row.id) else { return Ok(false) };
        if last.state != State::Done || last.settings != row.settings_hash() || last.input != self.input(row).ok() {
            return Ok(false);
        }
        let is_whole = Contents::of(&self.at(&row.output)).is_ok_and(|outputs| outputs.digest() == last.outputs);
        if is_whole {
            self.done.insert(place);
        }
        Ok(is_whole)
    }

    /// What an attempt at a row begins with.
    fn begin(&mut self, place: usize, claim: Claim) -> Result<Considered, EngineError> {
        let row = &self.manifest.rows()[place];
        let settings = row.settings_hash();
        let known = self.journal.last(&row.id);
        let number = known.map_or(0, |last| last.attempt) + 1;
        // What an attempt at other settings made was made by this row all the same.
        let is_ours = known.is_some();
        let goes_on = known.is_some_and(|last| last.settings == settings && !last.state.is_over());
        let mut record = Record::begun(&row.id, &row.job, number, settings, &self.name);
        record.notes = self.jobs.notes(row);
        let output = self.at(&row.output);
        if output.exists() && !is_ours && !self.policy.replace {
            let reason = "it exists, and no row of this manifest made it; --overwrite replaces it".to_owned();
            let looked = self.settle(place, &mut record, Err(EngineError::CannotCreate { path: output, reason }))?;
            (self.watch)(Event::Ends(row, &record));
            self.journal.add(&[record])?;
            return Ok(Considered::Refused(looked));
        }
        if is_ours {
            remove_partials(&output)?;
            remove_partials(&checkpoint::path_beside(&output))?;
        }
        let attempt = Attempt { number, replaces: is_ours || self.policy.replace, goes_on };
        Ok(Considered::Ready(Box::new(Begun { place, attempt, record, claim })))
    }

    /// Does one row, or several at once, and writes down what became of them.
    fn attempt(&mut self, mut begun: Vec<Begun>, summary: &mut Summary) -> Result<(), EngineError> {
        if begun.is_empty() {
            return Ok(());
        }
        let records: Vec<Record> = begun.iter().map(|row| row.record.clone()).collect();
        self.journal.add(&records)?;
        let rows: Vec<(&Row, Attempt)> =
            begun.iter().map(|begun| (&self.manifest.rows()[begun.place], begun.attempt)).collect();
        rows.iter().for_each(|(row, _)| (self.watch)(Event::Begins(row)));
        let started = Instant::now();
        let ended = self.run_twice(&rows);
        // Rows that were done at once share the time that they took.
        let seconds = started.elapsed().as_secs_f64();
        let alike: Vec<&Row> = rows.iter().map(|(row, _)| *row).collect();
        if ended.iter().all(Result::is_ok) && !self.jobs.is_light(alike[0]) {
            self.crowd.learn(&alike, seconds);
        }
        let (mut looked, count) = (Vec::with_capacity(rows.len()), rows.len() as f64);
        for (row, ended) in begun.iter_mut().zip(ended) {
            row.record.seconds = seconds / count;
            looked.push(self.settle(row.place, &mut row.record, ended)?);
        }
        let (records, claims): (Vec<Record>, Vec<Claim>) = begun.into_iter().map(|row| (row.record, row.claim)).unzip();
        self.journal.add(&records)?;
        drop(claims);
        for (((row, _), record), looked) in rows.into_iter().zip(&records).zip(looked) {
            (self.watch)(Event::Ends(row, record));
            summary.count(row, looked);
        }
        Ok(())
    }

    /// Does rows; those that lost the device once more, alone and on a fresh one.
    fn run_twice(&mut self, rows: &[(&Row, Attempt)]) -> Vec<Result<Ended, EngineError>> {
        let ended = match rows {
            [(row, attempt)] => vec![self.jobs.run(row, *attempt)],
            several => self.jobs.run_at_once(several),
        };
        let is_lost = |ended: &Result<Ended, EngineError>| {
            matches!(ended, Err(EngineError::Kernel(KernelError::DeviceLost { .. })))
        };
        if ended.iter().any(is_lost) {
            self.jobs.forget_device();
        }
        let again = |((row, attempt), ended): (&(&Row, Attempt), Result<Ended, EngineError>)| {
            if is_lost(&ended) { self.jobs.run(row, *attempt) } else { ended }
        };
        rows.iter().zip(ended).map(again).collect()
    }

    /// Puts into the record how a row ended.
    fn settle(
        &mut self,
        place: usize,
        record: &mut Record,
        ended: Result<Ended, EngineError>,
    ) -> Result<Looked, EngineError> {
        let row = &self.manifest.rows()[place];
        record.input = self.input(row).ok();
        let looked = match ended {
            Ok(Ended { exit_code, shortfall, result }) => {
                record.outputs = Contents::of(&self.at(&row.output))?;
                (record.exit_code, record.result) = (Some(exit_code), result);
                match shortfall {
                    None => Looked::Did,
                    Some(why) => Looked::Failed(why),
                }
            }
            Err(error @ (EngineError::Interrupted { .. } | EngineError::Stopped)) => {
                record.exit_code = Some(error.exit_code());
                Looked::Stopped
            }
            Err(error) => {
                record.exit_code = Some(error.exit_code());
                if matches!(error, EngineError::Kernel(KernelError::DeviceLost { .. })) {
                    self.jobs.forget_device();
                }
                Looked::Failed(error.to_string())
            }
        };
        record.state = match &looked {
            Looked::Did => State::Done,
            Looked::Stopped => State::Interrupted,
            _ => State::Failed,
        };
        record.ended_unix_s =
            SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).ok().map(|since| since.as_secs_f64());
        if let Looked::Failed(why) = &looked {
            record.error = Some(why.clone());
            self.failed.insert(place, why.clone());
        } else if record.state == State::Done {
            self.done.insert(place);
        }
        Ok(looked)
    }

    /// What the input of a row holds; one hash of nothing for a row without one.
    fn input(&self, row: &Row) -> Result<Digest, EngineError> {
        match row.input.as_str() {
            "" => Ok(Digest::of(b"")),
            input => Ok(Contents::of(&self.at(input))?.digest()),
        }
    }

    /// Where a path of a row is.
    fn at(&self, path: &str) -> PathBuf {
        self.manifest.folder().join(path)
    }
}
