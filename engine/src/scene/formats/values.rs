//! How splat files write numbers, as the values that splats are made of.

use crate::base::numbers::narrow;
use crate::scene::gaussians::{CHANNELS, Gaussians, SH_FLOATS, dc_of_colour, sh_bases};

/// Room for `splats` splats.
pub(crate) fn with_capacity(splats: usize, sh_degree: u32) -> Gaussians {
    Gaussians {
        means: Vec::with_capacity(splats),
        quats: Vec::with_capacity(splats),
        scales: Vec::with_capacity(splats),
        opacities: Vec::with_capacity(splats),
        sh_coeffs: vec![0.0; splats * SH_FLOATS],
        sh_degree,
    }
}

/// Floats of SH behind the DC terms that a splat of this degree has.
pub(super) const fn rest_floats(sh_degree: u32) -> usize {
    (sh_bases(sh_degree) - 1) * CHANNELS
}

/// The coefficients `[rows,16,3]` that bytes of plain colours are read as, three words for each splat.
pub(super) fn coeffs_of_colours(words: &[u32]) -> Vec<f32> {
    let mut coeffs = vec![0.0; words.len() / CHANNELS * SH_FLOATS];
    for (splat, words) in coeffs.chunks_exact_mut(SH_FLOATS).zip(words.chunks_exact(CHANNELS)) {
        for (coeff, word) in splat.iter_mut().zip(words) {
            *coeff = dc_of_colour(f32::from(word.to_le_bytes()[0]) / 255.0);
        }
    }
    coeffs
}

/// The coefficients `[rows,16,3]` of the splats `rows`, or of all.
pub(super) fn coeffs_of_rows(sh_coeffs: &[f32], rows: Option<&[u32]>) -> Vec<f32> {
    let splat = |row: &u32| &sh_coeffs[SH_FLOATS * *row as usize..][..SH_FLOATS];
    rows.map_or_else(|| sh_coeffs.to_vec(), |rows| rows.iter().flat_map(splat).copied().collect())
}

/// Logit of an opacity 0 to 1 that was stored in steps of 1/255. The ends, whose logit is infinite, are taken half a
/// step further in: below what is drawn at all (1/255), above what is drawn at most (0.99).
pub(super) fn logit(opacity: f32) -> f32 {
    const HALF_STEP: f64 = 0.5 / 255.0;
    let p = f64::from(opacity).clamp(HALF_STEP, 1.0 - HALF_STEP);
    narrow((p / (1.0 - p)).ln())
}

/// Logit of a byte.
pub(crate) fn logit_of_byte(byte: u8) -> f32 {
    logit(f32::from(byte) / 255.0)
}

/// Natural logarithm of a standard deviation; 0, which flat splats have, becomes the least that is told from it.
pub(super) fn log_scale(scale: f32) -> f32 {
    const LEAST: f32 = 1e-12;
    if scale == 0.0 { LEAST.ln() } else { scale.ln() }
}

/// The quaternion w, x, y, z whose component `largest` was left out for being the largest and positive; `others` are
/// the remaining ones in order.
pub(crate) fn with_largest(largest: usize, others: [f32; 3]) -> [f32; 4] {
    let squares: f32 = others.iter().map(|v| v * v).sum();
    let mut rest = others.into_iter();
    std::array::from_fn(|i| match i == largest {
        true => (1.0 - squares).max(0.0).sqrt(),
        false => rest.next().unwrap_or_default(),
    })
}
