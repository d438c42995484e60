//! Twin of `loss/mse_step`.

use crate::reference::Real;

/// Mean squared difference over colours of `[n,4]` and its gradient, fourth channel 0.
pub fn step<R: Real>(image: &[R], reference: &[R]) -> (R, Vec<R>) {
    super::per_colour(image, reference, |d| (d * d, d + d))
}
