//! What the report is made of.

use std::collections::BTreeMap;

use guard4d_engine::watermark::step_part::StepPart;
use guard4d_kernels::vk::MemoryUse;

/// Beginning of the names of the rows that shares are taken of.
pub(crate) const PROBES: &str = "probe/";

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

/// A place on an axis along which the cost is fitted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scale {
    /// `V` views, `F` frames or `N` splats.
    pub(crate) axis: &'static str,
    pub(crate) size: f64,
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
    /// Where it stands in a fit.
    pub(crate) scale: Option<Scale>,
}

/// What one embedding took.
pub(crate) struct MemoryRow {
    pub(crate) name: String,
    pub(crate) used: MemoryUse,
    /// Planning, fitting, and one step on average.
    pub(crate) seconds: [f64; 3],
}
