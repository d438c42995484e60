//! Twin of `loss/l1_step`.

use crate::reference::Real;

/// Mean absolute difference over colours of `[n,4]` and its gradient, fourth channel 0.
pub fn step<R: Real>(image: &[R], reference: &[R]) -> (R, Vec<R>) {
    super::per_colour(image, reference, |d| {
        let slope = if d > R::of(0.0) {
            R::of(1.0)
        } else if d < R::of(0.0) {
            R::of(-1.0)
        } else {
            d
        };
        (d.abs(), slope)
    })
}
