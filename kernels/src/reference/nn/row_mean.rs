//! Twin of `nn/row_mean`.

use crate::reference::real::{Real, count};

/// Mean of every row: `x` `[rows, width]` → `[rows]`.
pub fn forward<R: Real>(x: &[R], width: usize) -> Vec<R> {
    x.chunks_exact(width).map(|row| row.iter().copied().sum::<R>() / count(width)).collect()
}
