//! Twins of `image/levels_pack` and `image/levels_unpack`.

use crate::reference::real::Real;

/// Levels of 8 bits of pixels \[n,4\], a word each; NaN is 0.
#[allow(clippy::cast_possible_truncation, reason = "levels are 0 to 255")]
pub fn pack(x: &[f32]) -> Vec<u32> {
    let level = |v: f32| if v > 0.0 { (v.min(1.0) * 255.0 + 0.5).floor() as u32 } else { 0 };
    x.chunks_exact(4).map(|v| (0..4).map(|i| level(v[i]) << (8 * i)).sum()).collect()
}

/// Pixels \[n,4\] of such words.
pub fn unpack<R: Real>(levels: &[u32]) -> Vec<R> {
    let value = |level: u8| R::of(f64::from(level)) / R::of(255.0);
    levels.iter().flat_map(|word| word.to_le_bytes().map(value)).collect()
}
