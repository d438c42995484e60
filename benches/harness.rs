//! Sampling through criterion, and the rows that the report is made of.

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
        Ok(Self { device: Device::open(&select)?, criterion, rows: Vec::new(), partial: 0, load })
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
        self.samples(name, work, || {
            let mut rec = device.recorder()?;
            record(&mut rec)?;
            Ok(kernel_time(&rec.submit()?))
        })
    }

    /// Times that `once` returns. The first one, in which the driver compiles, is thrown away.
    pub(crate) fn samples(
        &mut self,
        name: &str,
        work: Work,
        mut once: impl FnMut() -> Result<Duration, EngineError>,
    ) -> Result<(), EngineError> {
        once()?;
        let mut samples = Vec::new();
        let mut failure = None;
        self.criterion.bench_function(name, |b| {
            b.iter_custom(|iterations| {
                let mut total = Duration::ZERO;
                for _ in 0..iterations {
                    match once() {
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
            self.rows.push(Row { name: name.to_owned(), work, samples });
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
