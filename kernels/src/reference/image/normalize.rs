//! Twin of `image/normalize`.

use crate::reference::real::Real;

/// (x − mean) / std of `[n,4]`, fourth channel 0.
pub fn forward<R: Real>(mean: [R; 3], std: [R; 3], x: &[R]) -> Vec<R> {
    let zero = R::of(0.0);
    x.chunks_exact(4)
        .flat_map(|v| [(v[0] - mean[0]) / std[0], (v[1] - mean[1]) / std[1], (v[2] - mean[2]) / std[2], zero])
        .collect()
}

/// Gradient to x.
pub fn backward<R: Real>(std: [R; 3], v_y: &[R]) -> Vec<R> {
    v_y.chunks_exact(4).flat_map(|v| [v[0] / std[0], v[1] / std[1], v[2] / std[2], R::of(0.0)]).collect()
}
