//! Twin of `nn/layer_norm`.

use crate::reference::real::{Real, count};

fn moments<R: Real>(row: &[R], eps: R) -> (R, R) {
    let n = count::<R>(row.len());
    let mean = row.iter().copied().sum::<R>() / n;
    let var = row.iter().map(|v| (*v - mean) * (*v - mean)).sum::<R>() / n;
    (mean, R::of(1.0) / (var + eps).sqrt())
}

/// Ba et al. 2016, eq. 4, for every row of `x`; the width is that of `gamma`.
pub fn forward<R: Real>(x: &[R], gamma: &[R], beta: &[R], eps: R) -> Vec<R> {
    let mut y = Vec::with_capacity(x.len());
    for row in x.chunks_exact(gamma.len()) {
        let (mean, rstd) = moments(row, eps);
        y.extend((0..row.len()).map(|i| (row[i] - mean) * rstd * gamma[i] + beta[i]));
    }
    y
}

/// Gradient to `x` with constant `gamma` and `beta`.
pub fn backward<R: Real>(x: &[R], gamma: &[R], v_y: &[R], eps: R) -> Vec<R> {
    let n = count::<R>(gamma.len());
    let mut v_x = Vec::with_capacity(x.len());
    for (row, v_row) in x.chunks_exact(gamma.len()).zip(v_y.chunks_exact(gamma.len())) {
        let (mean, rstd) = moments(row, eps);
        let g: Vec<R> = v_row.iter().zip(gamma).map(|(v, s)| *v * *s).collect();
        let x_hat: Vec<R> = row.iter().map(|v| (*v - mean) * rstd).collect();
        let mean_g = g.iter().copied().sum::<R>() / n;
        let mean_gx = g.iter().zip(&x_hat).map(|(a, b)| *a * *b).sum::<R>() / n;
        v_x.extend((0..row.len()).map(|i| rstd * (g[i] - mean_g - x_hat[i] * mean_gx)));
    }
    v_x
}
