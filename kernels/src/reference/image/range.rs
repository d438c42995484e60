//! The range of colours.

use crate::reference::real::Real;

/// One value clamped to \[0, 1\]; NaN stays NaN.
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

/// `v` where `x` lies in \[0, 1\], else 0.
pub fn gate<R: Real>(x: R, v: R) -> R {
    if x >= R::of(0.0) && x <= R::of(1.0) { v } else { R::of(0.0) }
}
