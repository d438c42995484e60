//! Twin of `loss/offset_penalty_step`.

use crate::reference::real::Real;

/// dc · mean(Δ_dc²) + rest · mean(Δ_rest²) of rows of `row` floats, 3 of them DC and `num_rest` others that count;
/// and its gradient.
pub fn step<R: Real>(offsets: &[R], row: usize, num_rest: usize, dc: R, rest: R) -> (R, Vec<R>) {
    let splats = offsets.len() as f64 / row as f64;
    let share = |i: usize| match i % row {
        0..3 => dc / R::of(splats * 3.0),
        k if k < 3 + num_rest => rest / R::of(splats * num_rest as f64),
        _ => R::of(0.0),
    };
    let value = offsets.iter().enumerate().map(|(i, d)| share(i) * *d * *d).sum();
    let grad = offsets.iter().enumerate().map(|(i, d)| R::of(2.0) * share(i) * *d).collect();
    (value, grad)
}
