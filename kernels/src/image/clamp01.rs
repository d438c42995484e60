//! Clamp of colours to [0, 1].

use crate::image::CHANNELS;
use crate::registry::image::{clamp01_bwd, clamp01_fwd};
use crate::shape::{dim, expect_len};
use crate::{Buffer, Grid, KernelError, Recorder};

const KERNEL: &str = "image/clamp01";

/// Clamps colours.
///
/// # Shapes
/// in `x` [n,4] · out `y` [n,4] (=); the fourth channel is copied
/// # Equation: min(max(x, 0), 1); NaN stays NaN
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(rec: &mut Recorder, x: &Buffer<f32>, y: &mut Buffer<f32>) -> Result<(), KernelError> {
    expect_len(KERNEL, "y", y, x.len())?;
    let n = x.len() / CHANNELS;
    rec.dispatch(clamp01_fwd::Bind { x, y }, clamp01_fwd::Params { n: dim(n) }, Grid::threads(n))
}

/// Gradient to the input; passes at both ends of the range, as PyTorch's `clamp`.
///
/// # Shapes
/// in `x` [n,4] before the clamp · `v_y` [n,4] · out `v_x` [n,4] (=), fourth channel 0
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    x: &Buffer<f32>,
    v_y: &Buffer<f32>,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    expect_len(KERNEL, "v_y", v_y, x.len())?;
    expect_len(KERNEL, "v_x", v_x, x.len())?;
    let n = x.len() / CHANNELS;
    rec.dispatch(clamp01_bwd::Bind { x, v_y, v_x }, clamp01_bwd::Params { n: dim(n) }, Grid::threads(n))
}
