//! The residual combination x + s·δ.

use crate::error::KernelError;
use crate::registry::nn::{axpy_bwd, axpy_fwd};
use crate::shape::{dim, expect_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "nn/axpy";

/// Adds a scaled tensor.
///
/// # Shapes
/// in `x` \[4n\] · `delta` \[4n\] · out `y` \[4n\] (=)
/// # Equation: y = x + s·δ
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    scale: f32,
    x: &Buffer<f32>,
    delta: &Buffer<f32>,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    expect_len(KERNEL, "delta", delta, x.len())?;
    expect_len(KERNEL, "y", y, x.len())?;
    expect_len(KERNEL, "x", x, x.len() / 4 * 4)?;
    let n = x.len() / 4;
    rec.dispatch(axpy_fwd::Bind { x, delta, y }, axpy_fwd::Params { n: dim(n), scale }, Grid::threads(n))
}

/// Gradient to `delta`; the gradient to `x` is `v_y` itself.
///
/// # Shapes
/// in `v_y` \[4n\] · out `v_delta` \[4n\] (=)
/// # Equation: s·v_y
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    scale: f32,
    v_y: &Buffer<f32>,
    v_delta: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    expect_len(KERNEL, "v_delta", v_delta, v_y.len())?;
    expect_len(KERNEL, "v_y", v_y, v_y.len() / 4 * 4)?;
    let n = v_y.len() / 4;
    rec.dispatch(axpy_bwd::Bind { v_y, v_delta }, axpy_bwd::Params { n: dim(n), scale }, Grid::threads(n))
}
