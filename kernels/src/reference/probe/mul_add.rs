//! Twin of `probe/mul_add_run`.

use crate::reference::real::Real;

/// Sum of the ends of `chains` chains v ← v·scale + shift of `steps` steps, from x, x + 1, …; for each x `[n]`.
pub fn run<R: Real>(chains: usize, steps: usize, scale: R, shift: R, x: &[R]) -> Vec<R> {
    let end = |start: R| (0..steps).fold(start, |v, _| v * scale + shift);
    let starts = |x: R| (0..chains).map(move |c| x + R::of(c as f64));
    x.iter().map(|&x| starts(x).map(end).sum()).collect()
}
