//! Twins of `glsl/image`.

pub mod chroma420;
pub mod colour_map;
pub mod crop;
pub mod jpeg;
pub mod noise;
pub mod normalize;
pub mod quantize;
pub mod resize;
pub mod warp;

use crate::reference::Real;

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
