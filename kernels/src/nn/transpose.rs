//! Transposed copy of a matrix.

use super::check::{as_u32, expect_len};
use crate::error::KernelError;
use crate::registry::nn::transpose_copy;
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "nn/transpose";

/// `y = xᵀ`, rows of `y` padded with zeros to a multiple of 4.
///
/// # Shapes
/// in `x` \[rows, cols\] · out `y` \[cols, ceil4(rows)\] (=)
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn copy(
    rec: &mut Recorder,
    x: &Buffer<f32>,
    rows: usize,
    cols: usize,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    expect_len(KERNEL, "x", x.len(), rows * cols, "rows*cols")?;
    expect_len(KERNEL, "y", y.len(), cols * rows.next_multiple_of(4), "cols*ceil4(rows)")?;
    let params = transpose_copy::Params { rows: as_u32(rows), cols: as_u32(cols) };
    rec.dispatch(transpose_copy::Bind { x, y }, params, Grid::threads(cols * rows.div_ceil(4)))
}
