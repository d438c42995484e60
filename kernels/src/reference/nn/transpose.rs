//! Twin of `nn/transpose`.

use crate::reference::real::Real;

/// `x` `[rows, cols]` → `[cols, ceil4(rows)]`, zero-padded.
pub fn copy<R: Real>(x: &[R], rows: usize, cols: usize) -> Vec<R> {
    let padded = rows.next_multiple_of(4);
    let mut y = vec![R::of(0.0); cols * padded];
    for row in 0..rows {
        for col in 0..cols {
            y[col * padded + row] = x[row * cols + col];
        }
    }
    y
}
