//! Twin of `nn/axpy`.

use crate::reference::real::Real;

/// x + s·δ
pub fn forward<R: Real>(scale: R, x: &[R], delta: &[R]) -> Vec<R> {
    x.iter().zip(delta).map(|(x, d)| *x + scale * *d).collect()
}

/// Gradient to δ.
pub fn backward<R: Real>(scale: R, v_y: &[R]) -> Vec<R> {
    v_y.iter().map(|v| scale * *v).collect()
}
