//! Mean of every row of a matrix.

use super::check::{as_u32, expect_len, expect_multiple};
use crate::error::KernelError;
use crate::registry::nn::row_mean_fwd;
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "nn/row_mean";

/// `mean[i]` = average of row i.
///
/// # Shapes
/// in `x` \[rows, width\], width a multiple of 4 · out `mean` \[rows\] (=)
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(rec: &mut Recorder, x: &Buffer<f32>, width: usize, mean: &mut Buffer<f32>) -> Result<(), KernelError> {
    expect_multiple(KERNEL, "width", width, 4)?;
    let rows = mean.len();
    expect_len(KERNEL, "x", x.len(), rows * width, "rows*width")?;
    let params = row_mean_fwd::Params { rows: as_u32(rows), width: as_u32(width) };
    rec.dispatch(row_mean_fwd::Bind { x_tex: x, mean }, params, Grid::threads(rows))
}
