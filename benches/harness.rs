//! Sampling through criterion, and the rows that the report is made of.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use criterion::Criterion;
use guard4d_engine::EngineError;
use guard4d_kernels::{Buffer, Device, DeviceSelect, KernelError, Recorder, Timings};

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
    /// Seconds of each run.
    pub(crate) samples: Vec<f64>,
    /// Mean seconds of a run by kernel; empty where the clock on the wall was read.
    pub(crate) split: BTreeMap<&'static str, f64>,
}

impl Row {
    /// Median of the samples in seconds.
    pub(crate) fn median(&self) -> f64 {
        let mut sorted = self.samples.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    }

    /// Operations or bytes per second.
    pub(crate) fn rate(&self) -> Option<f64> {
        match self.work {
            Work::Flops(work, _) | Work::Bytes(work, _) => Some(work / self.median()),
            Work::Mixed => None,
        }
    }
}

/// The device under test and what was measured on it.
pub(crate) struct Bench {
    pub(crate) device: Device,
    criterion: Criterion,
    pub(crate) rows: Vec<Row>,
    /// Kernels that ran in some row with timestamps.
    kernels: BTreeSet<&'static str>,
    /// Rows that the command line left out or cut short.
    pub(crate) partial: usize,
    /// Load of the machine before the first row.
    pub(crate) load: String,
}

impl Bench {
    /// Opens the device that `GUARD4D_DEVICE` names.
    pub(crate) fn open() -> Result<Self, EngineError> {
        let wanted = std::env::var("GUARD4D_DEVICE").unwrap_or_else(|_| "auto".to_owned());
        let select: DeviceSelect = wanted.parse().map_err(|e: String| EngineError::Usage {
            what: "GUARD4D_DEVICE".to_owned(),
            got: wanted,
            expected: e,
        })?;
        let criterion = Criterion::default()
            .sample_size(SAMPLES)
            .warm_up_time(WARM_UP)
            .measurement_time(MEASUREMENT)
            .configure_from_args();
        let load = crate::host::load();
        Ok(Self {
            device: Device::open(&select)?,
            criterion,
            rows: Vec::new(),
            kernels: BTreeSet::new(),
            partial: 0,
            load,
        })
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
        self.samples(name, work, || {
            let timings = once()?;
            for pass in &timings.passes {
                // Of the first run, which is thrown away, only the names count.
                let seconds = if runs == 0 { 0.0 } else { pass.time.as_secs_f64() };
                *split.entry(pass.name).or_default() += seconds;
            }
            runs += 1;
            Ok(kernel_time(&timings))
        })?;
        self.kernels.extend(split.keys());
        if let Some(row) = self.rows.last_mut().filter(|row| row.name == name) {
            row.split = split.into_iter().map(|(kernel, seconds)| (kernel, seconds / f64::from(runs - 1))).collect();
        }
        Ok(())
    }

    /// Kernels of the registry that no row ran, so that none is forgotten; nobody can tell after a part only.
    pub(crate) fn unmeasured(&self) -> Vec<&'static str> {
        let all = guard4d_kernels::registry::ALL.iter().map(|kernel| kernel.name);
        all.filter(|name| self.partial == 0 && !self.kernels.contains(name)).collect()
    }

    /// Times that `once` returns. The first one, in which the driver compiles, is thrown away; a row that the command
    /// line left out is never run.
    pub(crate) fn samples(
        &mut self,
        name: &str,
        work: Work,
        mut once: impl FnMut() -> Result<Duration, EngineError>,
    ) -> Result<(), EngineError> {
        let (mut samples, mut is_warm) = (Vec::new(), false);
        let mut failure = None;
        self.criterion.bench_function(name, |b| {
            b.iter_custom(|iterations| {
                let mut total = Duration::ZERO;
                let discarded = u64::from(!is_warm);
                is_warm = true;
                for run in 0..iterations + discarded {
                    match once() {
                        Ok(_) if run < discarded => {}
                        Ok(time) => {
                            samples.push(time.as_secs_f64());
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
        if samples.len() < SAMPLES {
            self.partial += 1;
        } else {
            self.rows.push(Row { name: name.to_owned(), work, samples, split: BTreeMap::new() });
        }
        Ok(())
    }

    /// Best rate of the rows whose names begin with `prefix`.
    pub(crate) fn peak(&self, prefix: &str) -> Option<f64> {
        let rates = self.rows.iter().filter(|r| r.name.starts_with(prefix)).filter_map(Row::rate);
        rates.max_by(f64::total_cmp)
    }
}

/// Time of the kernels alone: copies only reset their input, unless nothing else was recorded.
fn kernel_time(timings: &Timings) -> Duration {
    let kernels = timings.total().saturating_sub(timings.of("copy"));
    if kernels.is_zero() { timings.total() } else { kernels }
}
