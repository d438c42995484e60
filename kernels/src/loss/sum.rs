//! Deterministic sums: kernels leave partial sums, one workgroup adds them in order.

use std::ops::Range;

use crate::error::KernelError;
use crate::registry::loss::sum_finish;
use crate::shape::{dim, require_len};
use crate::vk::{Buffer, Device, Grid, Recorder};

/// Pixels or texels of one invocation of a loss kernel: long enough to hide a workgroup's start.
pub(crate) const PER_INVOCATION: u32 = 16;
/// Invocations of a workgroup of every loss kernel.
pub(crate) const LANES: usize = sum_finish::KERNEL.local_size[0] as usize;
/// Partial sums of a workgroup: one per eight lanes.
pub(crate) const PARTIALS_PER_GROUP: usize = LANES / 8;

/// Values that a loss leaves at most, from its slot on: the mean square, then the mean absolute difference.
pub const VALUES: usize = 2;

/// Partial sums of one loss.
#[derive(Debug)]
pub struct SumScratch {
    pub(crate) partial: Buffer<f32>,
}

impl SumScratch {
    /// Memory for losses over at most `n` pixels or texels, at most [`VALUES`] of them at a time.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, n: usize) -> Result<Self, KernelError> {
        Ok(Self { partial: device.buffer("loss.partial", VALUES * groups(n) * PARTIALS_PER_GROUP)? })
    }

    /// Workgroups for `n` elements, if their partial sums fit.
    pub(crate) fn groups(&self, kernel: &'static str, n: usize) -> Result<usize, KernelError> {
        require_len(kernel, "scratch", self.partial.len(), VALUES * groups(n) * PARTIALS_PER_GROUP)?;
        Ok(groups(n))
    }
}

fn groups(n: usize) -> usize {
    n.div_ceil(LANES * PER_INVOCATION as usize)
}

/// Writes `scale · Σ partial[range]` to `values[slot]`.
///
/// # Shapes
/// in `partial` \[≥ the range's end\] · out `values` \[> slot\], one element (=)
/// # Determinism: bitwise; strided sums of 64 lanes, then lane by lane
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn finish(
    rec: &mut Recorder,
    partial: &Buffer<f32>,
    range: Range<usize>,
    scale: f32,
    values: &mut Buffer<f32>,
    slot: usize,
) -> Result<(), KernelError> {
    require_len("loss/sum", "partial", partial.len(), range.end)?;
    require_len("loss/sum", "values", values.len(), slot + 1)?;
    let params = sum_finish::Params { first: dim(range.start), n: dim(range.len()), slot: dim(slot), scale };
    rec.dispatch(sum_finish::Bind { partial, values }, params, Grid::groups(1, 1, 1))
}
