//! Twin of `nn/l2_normalize`.

use crate::reference::real::Real;

fn norm<R: Real>(row: &[R]) -> R {
    row.iter().map(|v| *v * *v).sum::<R>().sqrt()
}

/// `y = x / |x|` per row of `width`.
pub fn forward<R: Real>(x: &[R], width: usize) -> Vec<R> {
    x.chunks_exact(width).flat_map(|row| row.iter().map(move |v| *v / norm(row))).collect()
}

/// `v_x = (v_y − x (x·v_y) / |x|²) / |x|` per row of `width`.
pub fn backward<R: Real>(x: &[R], v_y: &[R], width: usize) -> Vec<R> {
    let mut v_x = Vec::with_capacity(x.len());
    for (row, v_row) in x.chunks_exact(width).zip(v_y.chunks_exact(width)) {
        let length = norm(row);
        let along = row.iter().zip(v_row).map(|(a, b)| *a * *b).sum::<R>() / (length * length);
        v_x.extend(row.iter().zip(v_row).map(|(a, b)| (*b - *a * along) / length));
    }
    v_x
}
