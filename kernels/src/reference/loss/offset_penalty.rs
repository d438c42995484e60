//! Twin of `loss/offset_penalty_step`.

use crate::reference::Real;

/// dc · mean(Δ_dc²) + rest · mean(Δ_rest²) of `[N,16,3]`, and its gradient.
pub fn step<R: Real>(offsets: &[R], dc: R, rest: R) -> (R, Vec<R>) {
    let splats = offsets.len() as f64 / 48.0;
    let share = |i: usize| if i % 48 < 3 { dc / R::of(splats * 3.0) } else { rest / R::of(splats * 45.0) };
    let value = offsets.iter().enumerate().map(|(i, d)| share(i) * *d * *d).sum();
    let grad = offsets.iter().enumerate().map(|(i, d)| R::of(2.0) * share(i) * *d).collect();
    (value, grad)
}
