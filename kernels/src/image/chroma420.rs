//! Chroma at half resolution, as video and JPEG files keep it.

use super::colour_map::{ColourMap, transposed};
use super::frames::{expect_frames, frames_grid, two_maps};
use crate::error::KernelError;
use crate::registry::image::chroma420_apply;
use crate::shape::ClipShape;
use crate::vk::{Buffer, Recorder};

const KERNEL: &str = "image/chroma420";

/// Red, green, blue to luma and two chroma: BT.601 primaries, full range (JFIF 1.02).
pub const JFIF: ColourMap =
    [[0.299, 0.587, 0.114], [-0.168_735_89, -0.331_264_1, 0.5], [0.5, -0.418_687_6, -0.081_312_41]];

/// The inverse of a colour map, by cofactors.
///
/// # Panics
/// Never for maps that have one; a singular map gives numbers that are not finite.
#[must_use]
pub fn inverse(map: &ColourMap) -> ColourMap {
    let m = map.map(|row| row.map(f64::from));
    let cofactor = |r: usize, c: usize| {
        let [r0, r1, c0, c1] = [(r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3];
        m[r0][c0] * m[r1][c1] - m[r0][c1] * m[r1][c0]
    };
    let determinant: f64 = (0..3).map(|c| m[0][c] * cofactor(0, c)).sum();
    #[allow(clippy::cast_possible_truncation, reason = "colour maps are single precision")]
    std::array::from_fn(|r| std::array::from_fn(|c| (cofactor(c, r) / determinant) as f32))
}

/// Averages the chroma of every 2×2 quad.
///
/// # Shapes
/// in `x` \[F,H,W,4\], fourth channel ignored · out `y` likewise (=), fourth channel 0
/// # Equation: M⁻¹ P M x with M = [`JFIF`]; P replaces chroma by its mean over the pixel's quad
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(rec: &mut Recorder, clip: ClipShape, x: &Buffer<f32>, y: &mut Buffer<f32>) -> Result<(), KernelError> {
    apply(rec, clip, &JFIF, &inverse(&JFIF), x, y)
}

/// Gradient to the input of [`forward`].
///
/// # Shapes
/// in `v_y` \[F,H,W,4\], fourth channel ignored · out `v_x` likewise (=), fourth channel 0
/// # Equation: Mᵀ P M⁻ᵀ `v_y`: P is symmetric
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    clip: ClipShape,
    v_y: &Buffer<f32>,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    apply(rec, clip, &transposed(&inverse(&JFIF)), &transposed(&JFIF), v_y, v_x)
}

fn apply(
    rec: &mut Recorder,
    clip: ClipShape,
    a: &ColourMap,
    b: &ColourMap,
    x: &Buffer<f32>,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    expect_frames(KERNEL, clip, [("x", x), ("y", y)])?;
    let params = two_maps!(chroma420_apply, clip, *a, *b);
    let grid = frames_grid(clip.height * clip.width, clip.frames, chroma420_apply::KERNEL.local_size[0]);
    rec.dispatch(chroma420_apply::Bind { x, y }, params, grid)
}
