//! Twin of `optim/neighbour_mean_mix`.

use crate::reference::Real;

/// Rows `[N, row]` mixed with the mean of their neighbours' rows, neighbours `[N, K]`:
/// (1 − share) rows_i + share/K Σ_k rows_{neighbours(i, k)}. A neighbour that is not below N counts as zeros.
pub fn mix<R: Real>(rows: &[R], neighbours: &[u32], row: usize, share: R) -> Vec<R> {
    let n = rows.len() / row;
    let k = neighbours.len().checked_div(n).unwrap_or(0);
    let (keep, each) = (R::of(1.0) - share, share / R::of(k as f64));
    let mut mixed = vec![R::default(); rows.len()];
    for i in 0..n {
        for c in 0..row {
            mixed[i * row + c] = keep * rows[i * row + c];
            for j in neighbours[i * k..(i + 1) * k].iter().map(|j| *j as usize).filter(|j| *j < n) {
                mixed[i * row + c] += each * rows[j * row + c];
            }
        }
    }
    mixed
}
