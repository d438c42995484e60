//! Rows mixed with the mean of their neighbours' rows.

use crate::registry::optim::neighbour_mean_mix as kernel;
use crate::shape::{dim, expect_len};
use crate::{Buffer, Grid, KernelError, Recorder};

const KERNEL: &str = "optim/neighbour_mean";

/// Whose rows are mixed, and how much.
#[derive(Clone, Copy, Debug)]
pub struct Neighbourhood<'a> {
    /// `[N, K]`, K at least 1; one that is not below N counts as a row of zeros. K is the buffer's length by N.
    pub neighbours: &'a Buffer<u32>,
    /// Elements of a row, a multiple of 4.
    pub row: usize,
    /// Share of the mean, 0 to 1.
    pub share: f32,
}

/// Each row times 1 − share, plus the mean of its neighbours' rows times share: a low pass for what belongs to scattered
/// points.
///
/// # Shapes
/// in `rows` [N, row] · [`Neighbourhood`] · out `mixed` [N, row] (=)
/// # Equation: mixed_i = (1 − s) rows_i + s/K Σ_k rows_{neighbours(i, k)}
/// # Errors: [`KernelError::Shape`] before anything is recorded
/// # Determinism: bitwise; a gather without atomics, summed in the order of the neighbours. Rows that a binding cannot hold
/// are gathered in parts; with neighbours in ascending order that gives the same bits.
///
/// # Errors
/// See above.
pub fn mix(
    rec: &mut Recorder,
    rows: &Buffer<f32>,
    near: &Neighbourhood<'_>,
    mixed: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let Neighbourhood { neighbours, row, share } = *near;
    let (n, k) = shape(rows, near)?;
    expect_len(KERNEL, "mixed", mixed, rows.len())?;
    if n == 0 {
        return Ok(());
    }
    // An odd number of elements, so that parts of both rows and neighbours begin where bindings may.
    let row_bytes = size_of::<f32>() * (row.max(k) | 1);
    #[allow(clippy::cast_precision_loss, reason = "a few neighbours")]
    let each = share / k as f32;
    let spec = kernel::Spec { row_texels: dim(row / 4), k: dim(k) };
    for own in rec.pieces(n, row_bytes) {
        let elements = own.start * row..own.end * row;
        let mut out = mixed.part(elements.clone());
        for part in rec.pieces(n, row_bytes) {
            let is_first = part.start == 0;
            let bind = kernel::Bind {
                base: &if is_first { rows.part(elements.clone()) } else { out.alias() },
                rows: &rows.part(part.start * row..part.end * row),
                neighbours: &neighbours.part(own.start * k..own.end * k),
                mixed: &mut out,
            };
            let texels = elements.len() / 4;
            let keep = if is_first { 1.0 - share } else { 1.0 };
            let (first_row, part) = (dim(part.start), dim(part.len()));
            let params = kernel::Params { texels: dim(texels), first_row, part, keep, share: each };
            rec.dispatch_spec(bind, params, spec, Grid::threads(texels))?;
        }
    }
    Ok(())
}

/// Rows, and neighbours of each.
fn shape(rows: &Buffer<f32>, near: &Neighbourhood<'_>) -> Result<(usize, usize), KernelError> {
    let (row, len) = (near.row, near.neighbours.len());
    let refused = |buffer, got: usize, expected: String| KernelError::Shape {
        kernel: KERNEL,
        buffer,
        got: format!("[{got}]"),
        expected,
    };
    if row == 0 || !row.is_multiple_of(4) || !rows.len().is_multiple_of(row) {
        return Err(refused("rows", rows.len(), format!("rows of {row}, which is to be a multiple of 4")));
    }
    let n = rows.len() / row;
    let k = len.checked_div(n).unwrap_or(0);
    if len != n * k || (n > 0 && k == 0) {
        return Err(refused("neighbours", len, format!("[{n}, K] with a K of at least 1")));
    }
    Ok((n, k))
}
