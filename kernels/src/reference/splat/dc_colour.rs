//! Twin of `splat/dc_colour_fwd` and `splat/dc_colour_bwd`.

use super::sh::{basis, clamped, v_raw};
use crate::reference::real::Real;

/// Y₀, the same in every direction.
fn constant<R: Real>() -> R {
    basis([R::of(0.0); 3], 0)[0]
}

/// Colours before the clamp `[V,3]`: `base` `[V,4]` plus Y₀ times rows `splats` of `offsets` `[N,4]`.
fn raw<R: Real>(base: &[R], offsets: &[R], splats: &[usize]) -> Vec<[R; 3]> {
    let row = |(b, &splat): (&[R], &usize)| std::array::from_fn(|k| b[k] + constant::<R>() * offsets[4 * splat + k]);
    base.chunks_exact(4).zip(splats).map(row).collect()
}

/// Colours `[V,4]`, at most `most`.
#[must_use]
pub fn forward<R: Real>(base: &[R], offsets: &[R], splats: &[usize], most: R) -> Vec<R> {
    let colour = |c: [R; 3]| [clamped(c[0], most), clamped(c[1], most), clamped(c[2], most), R::of(0.0)];
    raw(base, offsets, splats).into_iter().flat_map(colour).collect()
}

/// Gradient `[N,4]` of the offsets.
#[must_use]
pub fn backward<R: Real>(base: &[R], offsets: &[R], splats: &[usize], most: R, v_colours: &[R]) -> Vec<R> {
    let mut v_offsets = vec![R::of(0.0); offsets.len()];
    for ((c, &splat), v) in raw(base, offsets, splats).into_iter().zip(splats).zip(v_colours.chunks_exact(4)) {
        for k in 0..3 {
            v_offsets[4 * splat + k] += constant::<R>() * v_raw(c[k], v[k], most);
        }
    }
    v_offsets
}
