//! Twin of `nn/column_sum`.

use crate::reference::real::Real;

/// Sum over rows: `x` `[rows, width]` → `[width]`.
pub fn forward<R: Real>(x: &[R], width: usize) -> Vec<R> {
    let mut sum = vec![R::of(0.0); width];
    for row in x.chunks_exact(width) {
        for (s, v) in sum.iter_mut().zip(row) {
            *s += *v;
        }
    }
    sum
}
