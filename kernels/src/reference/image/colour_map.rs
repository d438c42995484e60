//! Twin of `image/colour_map`.

use crate::reference::real::Real;

/// M x of `[n,4]`, fourth channel 0.
pub fn forward<R: Real>(map: [[R; 3]; 3], x: &[R]) -> Vec<R> {
    let row = |m: [R; 3], v: &[R]| m[0] * v[0] + m[1] * v[1] + m[2] * v[2];
    x.chunks_exact(4).flat_map(|v| [row(map[0], v), row(map[1], v), row(map[2], v), R::of(0.0)]).collect()
}

/// Gradient to x: Mᵀ v_y, fourth channel 0.
pub fn backward<R: Real>(map: [[R; 3]; 3], v_y: &[R]) -> Vec<R> {
    let mut v_x = vec![R::of(0.0); v_y.len()];
    for (v_x, v_y) in v_x.chunks_exact_mut(4).zip(v_y.chunks_exact(4)) {
        for (row, v) in map.iter().zip(v_y) {
            for (out, m) in v_x.iter_mut().zip(row) {
                *out += *m * *v;
            }
        }
    }
    v_x
}
