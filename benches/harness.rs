//! Sampling through criterion, and the rows that the report is made of.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::Duration;

use cpu_time::ProcessTime;
use criterion::Criterion;
use guard4d_engine::EngineError;
use guard4d_engine::watermark::embed::StepPart;
use guard4d_kernels::vk::{DeviceKind, KernelDef};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder, Timings};

use crate::memory::MemoryRow;
use crate::probe::PROBES;
use crate::stats::Quartiles;

/// Samples of one row; criterion's least.
pub(crate) const SAMPLES: usize = 10;
const WARM_UP: Duration = Duration::from_millis(200);
const MEASUREMENT: Duration = Duration::from_secs(1);

/// Useful work of one run, and the formula it comes from.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Work {
    /// Floating-point operations.
    Flops(f64, &'static str),
    /// Bytes that must cross the memory bus at least once.
    Bytes(f64, &'static str),
    /// A mixture that has no single peak.
    Mixed,
}

/// One line of the report.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    pub(crate) name: String,
    pub(crate) work: Work,
    /// Seconds of each run by the device's clock, or by the one on the wall where the name says so.
    pub(crate) seconds: Vec<f64>,
    /// CPU seconds of each run, over all threads of this process; a software driver's are among them.
    pub(crate) core_seconds: Vec<f64>,
    /// Mean seconds of a run by kernel; empty where the clock on the wall was read.
    pub(crate) split: BTreeMap<&'static str, f64>,
    /// Mean device seconds of an embedding step by part.
    pub(crate) stages: BTreeMap<StepPart, f64>,
    /// Axis of a fit and place on it.
    pub(crate) scale: Option<(&'static str, f64)>,
}

impl Row {
    pub(crate) fn time(&self) -> Quartiles {
        Quartiles::of(&self.seconds)
    }

    pub(crate) fn core_time(&self) -> Quartiles {
        Quartiles::of(&self.core_seconds)
    }

    /// CPU seconds of the fastest run: what the code takes when nobody else slows the core down.
    pub(crate) fn best_core_seconds(&self) -> f64 {
        self.core_seconds.iter().copied().fold(f64::NAN, f64::min)
    }

    /// The shortest run by the device's clock, or by the one on the wall.
    pub(crate) fn best_seconds(&self) -> f64 {
        self.seconds.iter().copied().fold(f64::NAN, f64::min)
    }

    fn work(&self) -> Option<f64> {
        match self.work {
            Work::Flops(work, _) | Work::Bytes(work, _) => Some(work),
            Work::Mixed => None,
        }
    }

    /// Operations or bytes per second.
    pub(crate) fn rate(&self) -> Option<f64> {
        self.work().map(|work| work / self.time().median)
    }

    /// Operations or bytes per CPU second of the fastest run.
    pub(crate) fn best_core_rate(&self) -> Option<f64> {
        self.work().map(|work| work / self.best_core_seconds())
    }

    /// Operations or bytes per CPU second.
    pub(crate) fn core_rate(&self) -> Option<f64> {
        self.work().map(|work| work / self.core_time().median)
    }
}

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
    /// Load of the machine before the first row.
    pub(crate) load: String,
}

impl Bench {
    /// Rows on this device.
    pub(crate) fn new(device: Device, filters: Vec<String>) -> Self {
        let criterion = Criterion::default().sample_size(SAMPLES).warm_up_time(WARM_UP).measurement_time(MEASUREMENT);
        let load = crate::host::load();
        let (rows, memory, kernels) = (Vec::new(), Vec::new(), BTreeSet::new());
        Self { device, criterion, rows, memory, scenes: None, kernels, filters, load }
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
        let mean = |(&kernel, seconds): (&&'static str, &f64)| (kernel, seconds / f64::from(runs - 1));
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
        let all = guard4d_kernels::registry::ALL.iter().filter(runs).map(|kernel| kernel.name);
        all.filter(|name| !self.is_partial() && !self.kernels.contains(name)).collect()
    }

    /// Times that `once` returns, and the CPU time that it takes. The first one, in which the driver compiles, is
    /// thrown away; a row that the command line left out is never run and is `None`.
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
        let name = name.to_owned();
        let (split, stages) = (BTreeMap::new(), BTreeMap::new());
        self.rows.push(Row { name, work, seconds, core_seconds, split, stages, scale: None });
        Ok(self.rows.last_mut())
    }

    /// Best rate of the rows whose names begin with `prefix`, by their clock or by CPU time.
    pub(crate) fn peak(&self, prefix: &str, rate: impl Fn(&Row) -> Option<f64>) -> Option<f64> {
        self.rows.iter().filter(|r| r.name.starts_with(prefix)).filter_map(rate).max_by(f64::total_cmp)
    }
}

/// Time of the kernels alone: copies only reset their input, unless nothing else was recorded.
fn kernel_time(timings: &Timings) -> Duration {
    let kernels = timings.total().saturating_sub(timings.of("copy"));
    if kernels.is_zero() { timings.total() } else { kernels }
}
