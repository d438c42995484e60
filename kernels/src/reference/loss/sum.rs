//! Twin of `loss/sum_finish`.

use crate::reference::real::Real;

/// Scaled sum.
pub fn finish<R: Real>(partial: &[R], scale: R) -> R {
    scale * partial.iter().copied().sum::<R>()
}
