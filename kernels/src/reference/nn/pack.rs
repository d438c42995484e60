//! Twin of `nn/pack`.

use crate::nn::pack::{LANES, TEXEL};
use crate::reference::real::Real;

/// `w` `[n, k]` as `[n/8][k/4][8 lanes]` vec4, zero-padded.
pub fn rows<R: Real>(w: &[R], n: usize, k: usize) -> Vec<R> {
    let mut packed = Vec::new();
    for block in 0..n.div_ceil(LANES) {
        for texel in 0..k.div_ceil(TEXEL) {
            for lane in 0..LANES {
                for component in 0..TEXEL {
                    let (row, col) = (block * LANES + lane, texel * TEXEL + component);
                    packed.push(if row < n && col < k { w[row * k + col] } else { R::of(0.0) });
                }
            }
        }
    }
    packed
}

/// `w` `[n, k]` rounded to 16-bit codes with a scale per row, as floats again.
pub fn fixed16(w: &[f32], k: usize) -> Vec<f32> {
    let mut rounded = Vec::new();
    for row in w.chunks_exact(k) {
        let largest = row.iter().fold(0.0f32, |a, b| a.max(b.abs()));
        let unit = if largest > 0.0 { largest / 32_767.0 } else { 1.0 };
        rounded.extend(row.iter().map(|v| (v / unit).round() * unit));
    }
    rounded
}
