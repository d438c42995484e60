//! Sum over the rows of a matrix: the gradient of a bias.

use super::check::{as_u32, expect_len, expect_multiple, shape_error};
use crate::error::KernelError;
use crate::registry::nn::column_sum_fwd;
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "nn/column_sum";
/// Lavapipe 22.3 ends every loop of an invocation after 65,535 iterations.
const MAX_ROWS: usize = 65_535;

/// `sum[j]` = Σᵢ x(i, j).
///
/// # Shapes
/// in `x` \[rows, width\], width a multiple of 4, at most 65,535 rows · out `sum` \[width\] (=)
/// # Determinism: bitwise; rows are added in order
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(rec: &mut Recorder, x: &Buffer<f32>, sum: &mut Buffer<f32>) -> Result<(), KernelError> {
    let width = sum.len();
    expect_multiple(KERNEL, "sum", width, 4)?;
    let rows = x.len() / width;
    expect_len(KERNEL, "x", x.len(), rows * width, "rows*width")?;
    if rows > MAX_ROWS {
        return Err(shape_error(KERNEL, "x", format!("{rows} rows"), format!("at most {MAX_ROWS}")));
    }
    if rows == 0 {
        rec.fill(sum, 0.0);
        return Ok(());
    }
    let params = column_sum_fwd::Params { rows: as_u32(rows), width: as_u32(width) };
    rec.dispatch(column_sum_fwd::Bind { x_tex: x, sum }, params, Grid::threads(width / 4))
}
