//! Twin of `image/clamp01`.

use crate::reference::Real;

/// One value clamped to [0, 1]; NaN stays NaN.
pub fn clamp<R: Real>(v: R) -> R {
    let (zero, one) = (R::of(0.0), R::of(1.0));
    if v < zero {
        zero
    } else if v > one {
        one
    } else {
        v
    }
}

/// `v` where `x` lies in [0, 1], else 0.
pub fn gate<R: Real>(x: R, v: R) -> R {
    if x >= R::of(0.0) && x <= R::of(1.0) { v } else { R::of(0.0) }
}

/// Clamps colours of `[n,4]`; the fourth channel is copied.
pub fn forward<R: Real>(x: &[R]) -> Vec<R> {
    x.chunks_exact(4).flat_map(|v| [clamp(v[0]), clamp(v[1]), clamp(v[2]), v[3]]).collect()
}

/// Gradient to x, fourth channel 0.
pub fn backward<R: Real>(x: &[R], v_y: &[R]) -> Vec<R> {
    let pixels = x.chunks_exact(4).zip(v_y.chunks_exact(4));
    pixels.flat_map(|(x, v)| [gate(x[0], v[0]), gate(x[1], v[1]), gate(x[2], v[2]), R::of(0.0)]).collect()
}
