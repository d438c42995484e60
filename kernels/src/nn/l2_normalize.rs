//! Rows scaled to unit length.

use super::check::{as_u32, expect_len, expect_multiple};
use crate::error::KernelError;
use crate::registry::nn::{l2_normalize_bwd, l2_normalize_fwd};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "nn/l2_normalize";

/// `y = x / |x|` per row, without an epsilon: a zero row gives NaN.
///
/// # Shapes
/// in `x` \[rows, width\], width a multiple of 4 · out `y` \[rows, width\] (=)
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(rec: &mut Recorder, x: &Buffer<f32>, width: usize, y: &mut Buffer<f32>) -> Result<(), KernelError> {
    let rows = whole_rows(x.len(), width)?;
    expect_len(KERNEL, "y", y.len(), x.len(), "like x")?;
    let params = l2_normalize_fwd::Params { rows: as_u32(rows), width: as_u32(width) };
    rec.dispatch(l2_normalize_fwd::Bind { x_tex: x, y }, params, Grid::threads(rows))
}

/// `v_x = (v_y − y (y·v_y)) / |x|` per row.
///
/// # Shapes
/// in `x` \[rows, width\] (the forward pass's input) · `v_y` \[rows, width\] · out `v_x` \[rows, width\] (=)
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    x: &Buffer<f32>,
    v_y: &Buffer<f32>,
    width: usize,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let rows = whole_rows(x.len(), width)?;
    expect_len(KERNEL, "v_y", v_y.len(), x.len(), "like x")?;
    expect_len(KERNEL, "v_x", v_x.len(), x.len(), "like x")?;
    let params = l2_normalize_bwd::Params { rows: as_u32(rows), width: as_u32(width) };
    rec.dispatch(l2_normalize_bwd::Bind { x_tex: x, v_y_tex: v_y, v_x }, params, Grid::threads(rows))
}

fn whole_rows(len: usize, width: usize) -> Result<usize, KernelError> {
    expect_multiple(KERNEL, "width", width, 4)?;
    expect_len(KERNEL, "x", len, len / width * width, "whole rows")?;
    Ok(len / width)
}
