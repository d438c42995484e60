//! Twin of `nn/embedding`.

use crate::reference::real::Real;

/// `y[r] = table[ids[r]] + position[r mod tokens]`, rows of `width`.
pub fn gather<R: Real>(ids: &[u32], table: &[R], position: &[R], tokens: usize, width: usize) -> Vec<R> {
    let mut y = Vec::with_capacity(ids.len() * width);
    for (row, id) in ids.iter().enumerate() {
        for d in 0..width {
            y.push(table[*id as usize * width + d] + position[(row % tokens) * width + d]);
        }
    }
    y
}
