//! Twin of `image/quantize_round`.

use super::range::clamp;
use crate::reference::real::Real;

/// Colours of `[n,4]` rounded to 8 bits, halves up; the fourth channel is copied.
pub fn forward<R: Real>(x: &[R]) -> Vec<R> {
    let round = |v: R| (clamp(v) * R::of(255.0) + R::of(0.5)).floor() / R::of(255.0);
    x.chunks_exact(4).flat_map(|v| [round(v[0]), round(v[1]), round(v[2]), v[3]]).collect()
}
