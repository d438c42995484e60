//! Sampling through criterion, and what was sampled.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::Duration;

use cpu_time::ProcessTime;
use criterion::Criterion;
use guard4d_engine::error::EngineError;
use guard4d_kernels::vk::{DeviceKind, KernelDef};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder, Timings, registry};

use super::row::{MemoryRow, PROBES, Row, Work};

/// How a row, or a family of rows, ends.
pub(crate) type Outcome = Result<(), EngineError>;

/// Samples of one row; criterion's least.
pub(crate) const SAMPLES: usize = 10;
const WARM_UP: Duration = Duration::from_millis(200);
const MEASUREMENT: Duration = Duration::from_secs(1);

/// The device under test and what was measured on it.
pub(crate) struct Bench {
    pub(crate) device: Device,
    criterion: Criterion,
    pub(crate) rows: Vec<Row>,
    /// Embeddings of which the memory was measured.
    pub(crate) memory: Vec<MemoryRow>,
    /// Folder that the made scenes are written to.
    pub(crate) scenes: Option<PathBuf>,
    /// Kernels that ran in some row with timestamps.
    kernels: BTreeSet<&'static str>,
    /// A row's name must contain one of these, if there are any.
    filters: Vec<String>,
    effort: Effort,
}

/// What the rows are run for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Effort {
    /// For their times.
    Measure,
    /// To see that each of them runs: once, and small where that saves much.
    Check,
}

impl Bench {
    /// Rows on this device.
    pub(crate) fn new(device: Device, filters: Vec<String>, effort: Effort) -> Self {
        let criterion = Criterion::default().sample_size(SAMPLES).warm_up_time(WARM_UP).measurement_time(MEASUREMENT);
        let (rows, memory, kernels) = (Vec::new(), Vec::new(), BTreeSet::new());
        Self { device, criterion, rows, memory, scenes: None, kernels, filters, effort }
    }

    /// Whether the command line leaves rows out.
    pub(crate) fn is_partial(&self) -> bool {
        !self.filters.is_empty()
    }

    /// Whether the command line asks for a row; what only serves others need not be prepared. Shares need the probes.
    pub(crate) fn wants(&self, name: &str) -> bool {
        let asked = |part: &String| name.contains(part.as_str());
        !self.is_partial() || name.starts_with(PROBES) || self.filters.iter().any(asked)
    }

    /// What rows are measured with, or something smaller that takes the same ways where they are only checked.
    pub(crate) fn size<T>(&self, measured: T, checked: T) -> T {
        match self.effort {
            Effort::Measure => measured,
            Effort::Check => checked,
        }
    }

    /// Whether the device computes on this processor, so that CPU time says what it did.
    pub(crate) fn is_cpu(&self) -> bool {
        self.device.info().kind == DeviceKind::Cpu
    }

    /// Values between 0 and 1 without a pattern that a cache or a branch predictor could learn.
    pub(crate) fn data(&self, name: &str, len: usize) -> Result<Buffer<f32>, KernelError> {
        let value = |i: usize| (i * 7919 % 1009) as f32 / 1009.0;
        self.device.buffer_from(name, &(0..len).map(value).collect::<Vec<_>>())
    }

    /// Device time of all passes that `record` records.
    pub(crate) fn passes(
        &mut self,
        name: &str,
        work: Work,
        mut record: impl FnMut(&mut Recorder) -> Result<(), KernelError>,
    ) -> Result<(), EngineError> {
        let device = self.device.clone();
        self.timed(name, work, || {
            let mut rec = device.recorder()?;
            record(&mut rec)?;
            Ok(rec.submit()?)
        })
    }

    /// Device time of what `once` submits, in all and by kernel.
    pub(crate) fn timed(
        &mut self,
        name: &str,
        work: Work,
        mut once: impl FnMut() -> Result<Timings, EngineError>,
    ) -> Result<(), EngineError> {
        let (mut runs, mut split) = (0, BTreeMap::<_, f64>::new());
        let row = self.samples(name, work, || {
            let timings = once()?;
            for pass in &timings.passes {
                // Of the first run, which is thrown away, only the names count.
                let seconds = if runs == 0 { 0.0 } else { pass.time.as_secs_f64() };
                *split.entry(pass.name).or_default() += seconds;
            }
            runs += 1;
            Ok(kernel_time(&timings))
        })?;
        let Some(row) = row else { return Ok(()) };
        let mean = |(&kernel, seconds): (&&'static str, &f64)| (kernel, seconds / f64::from(runs - 1).max(1.0));
        row.split = split.iter().map(mean).collect();
        self.kernels.extend(split.keys());
        Ok(())
    }

    /// A row of times that one thread of the host took, with the device at rest: they are CPU times too.
    pub(crate) fn host_times(&mut self, name: String, seconds: Vec<f64>) {
        let (core_seconds, split, stages) = (seconds.clone(), BTreeMap::new(), BTreeMap::new());
        self.rows.push(Row { name, work: Work::Mixed, seconds, core_seconds, split, stages, scale: None });
    }

    /// Kernels of the registry that no row ran, so that none is forgotten; nobody can tell after a part only.
    pub(crate) fn unmeasured(&self) -> Vec<&'static str> {
        let info = self.device.info();
        let runs = |kernel: &&&KernelDef| kernel.runs_on(self.device.family(), info);
        let all = registry::ALL.iter().filter(runs).map(|kernel| kernel.name);
        all.filter(|name| !self.is_partial() && !self.kernels.contains(name)).collect()
    }

    /// Refuses a row that ran without one of these kernels, as far as the device can run it: a row that is there for a
    /// variant must not take another way unnoticed. A row that the command line left out is passed over.
    pub(crate) fn expect(&self, name: &str, kernels: &[&'static KernelDef]) -> Outcome {
        let Some(row) = self.rows.iter().find(|row| row.name == name) else { return Ok(()) };
        let runs = |kernel: &KernelDef| kernel.runs_on(self.device.family(), self.device.info());
        match kernels.iter().find(|kernel| runs(kernel) && !row.split.contains_key(kernel.name)) {
            None => Ok(()),
            Some(kernel) => Err(EngineError::Usage {
                what: name.to_owned(),
                got: format!("a row that runs {:?}", row.split.keys()),
                expected: format!("one that runs {}", kernel.name),
            }),
        }
    }

    /// Times that `once` returns, and the CPU time that it takes. The first one, in which the driver compiles, is
    /// thrown away, but for a check, which has no other; a row that the command line left out is never run and is
    /// `None`.
    pub(crate) fn samples(
        &mut self,
        name: &str,
        work: Work,
        mut once: impl FnMut() -> Result<Duration, EngineError>,
    ) -> Result<Option<&mut Row>, EngineError> {
        if !self.wants(name) {
            return Ok(None);
        }
        let (mut seconds, mut core_seconds, mut is_warm) = (Vec::new(), Vec::new(), false);
        let mut failure = None;
        if self.effort == Effort::Check {
            println!("{name}");
            seconds.push(once()?.as_secs_f64());
            return Ok(Some(self.row(name, work, seconds, core_seconds)));
        }
        self.criterion.bench_function(name, |b| {
            b.iter_custom(|iterations| {
                let mut total = Duration::ZERO;
                let discarded = u64::from(!is_warm);
                is_warm = true;
                for run in 0..iterations + discarded {
                    // After a failure there is nothing to wait for, but criterion must be told some time.
                    if failure.is_some() {
                        break;
                    }
                    let busy = ProcessTime::now();
                    match once() {
                        Ok(_) if run < discarded => {}
                        Ok(time) => {
                            core_seconds.push(busy.elapsed().as_secs_f64());
                            seconds.push(time.as_secs_f64());
                            total += time;
                        }
                        Err(error) => failure = Some(error),
                    }
                }
                // Criterion divides by it, and a kernel may be faster than the device's clock.
                total.max(Duration::from_nanos(1))
            });
        });
        if let Some(error) = failure {
            return Err(error);
        }
        Ok(Some(self.row(name, work, seconds, core_seconds)))
    }

    fn row(&mut self, name: &str, work: Work, seconds: Vec<f64>, core_seconds: Vec<f64>) -> &mut Row {
        let (name, split, stages) = (name.to_owned(), BTreeMap::new(), BTreeMap::new());
        self.rows.push_mut(Row { name, work, seconds, core_seconds, split, stages, scale: None })
    }
}

/// Time of the kernels alone: copies only reset their input, unless nothing else was recorded.
fn kernel_time(timings: &Timings) -> Duration {
    let kernels = timings.total().saturating_sub(timings.of("copy"));
    if kernels.is_zero() { timings.total() } else { kernels }
}
