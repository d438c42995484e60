//! Deterministic sums: kernels leave partial sums, one workgroup adds them in order.

use crate::registry::loss::sum_finish;
use crate::shape::dim;
use crate::{Buffer, Device, Grid, KernelError, Recorder};

/// Pixels or texels of one invocation of a loss kernel: long enough to hide a workgroup's start.
pub(crate) const PER_INVOCATION: u32 = 16;
/// Invocations of a workgroup of every loss kernel.
pub(crate) const LANES: usize = sum_finish::KERNEL.local_size[0] as usize;
/// Partial sums of a workgroup: one per eight lanes.
pub(crate) const PARTIALS_PER_GROUP: usize = LANES / 8;

/// Partial sums of one loss.
#[derive(Debug)]
pub struct SumScratch {
    pub(crate) partial: Buffer<f32>,
}

impl SumScratch {
    /// Memory for losses over at most `n` pixels or texels.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, n: usize) -> Result<Self, KernelError> {
        Ok(Self { partial: device.buffer("loss.partial", groups(n) * PARTIALS_PER_GROUP)? })
    }

    /// Workgroups for `n` elements, if their partial sums fit.
    pub(crate) fn groups(&self, kernel: &'static str, n: usize) -> Result<usize, KernelError> {
        let partials = groups(n) * PARTIALS_PER_GROUP;
        if partials <= self.partial.len() {
            return Ok(groups(n));
        }
        Err(KernelError::Shape {
            kernel,
            buffer: "scratch",
            got: format!("[{}]", self.partial.len()),
            expected: format!("at least [{partials}]"),
        })
    }
}

fn groups(n: usize) -> usize {
    n.div_ceil(LANES * PER_INVOCATION as usize)
}

/// Writes `scale · Σ partial[..n]` to `values[slot]`.
///
/// # Shapes
/// in `partial` [≥ n] · out `values` [> slot], one element (=)
/// # Determinism: bitwise; strided sums of 64 lanes, then lane by lane
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn finish(
    rec: &mut Recorder,
    (partial, n): (&Buffer<f32>, usize),
    scale: f32,
    (values, slot): (&mut Buffer<f32>, usize),
) -> Result<(), KernelError> {
    for (buffer, got, least) in [("partial", partial.len(), n), ("values", values.len(), slot + 1)] {
        if got < least {
            let expected = format!("at least [{least}]");
            return Err(KernelError::Shape { kernel: "loss/sum", buffer, got: format!("[{got}]"), expected });
        }
    }
    let params = sum_finish::Params { n: dim(n), slot: dim(slot), scale };
    rec.dispatch(sum_finish::Bind { partial, values }, params, Grid::groups(1, 1, 1))
}
