//! Twin of `nn/patch_embed`.

use crate::nn::patch_embed::PatchShape;
use crate::reference::real::Real;

/// Calls `pair(row element, pixel element)` for every colour that [`unfold`] copies.
fn each_pair(s: PatchShape, mut pair: impl FnMut(usize, usize)) {
    let grid = s.side_px / s.patch_px;
    for image in 0..s.batch {
        for cell in 0..grid * grid {
            for inner in 0..s.patch_px * s.patch_px {
                let y = (cell / grid) * s.patch_px + inner / s.patch_px;
                let x = (cell % grid) * s.patch_px + inner % s.patch_px;
                let row = image * s.tokens() + 1 + cell;
                for channel in 0..3 {
                    pair(
                        row * s.row_len() + inner * 4 + channel,
                        ((image * s.side_px + y) * s.side_px + x) * 4 + channel,
                    );
                }
            }
        }
    }
}

/// `pixels` `[B, side, side, 4]` → `[B*tokens, patch*patch*4]`.
pub fn unfold<R: Real>(s: PatchShape, pixels: &[R]) -> Vec<R> {
    let mut rows = vec![R::of(0.0); s.rows_len()];
    each_pair(s, |row, pixel| rows[row] = pixels[pixel]);
    rows
}

/// Adjoint of [`unfold`].
pub fn fold<R: Real>(s: PatchShape, v_rows: &[R]) -> Vec<R> {
    let mut v_pixels = vec![R::of(0.0); s.pixels_len()];
    each_pair(s, |row, pixel| v_pixels[pixel] += v_rows[row]);
    v_pixels
}
