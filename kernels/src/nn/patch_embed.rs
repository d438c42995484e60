//! Images to rows of patches and back.

use super::check::{as_u32, expect_len, shape_error};
use crate::error::KernelError;
use crate::registry::nn::{patch_embed_fold, patch_embed_unfold};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "nn/patch_embed";
/// Channels of a pixel in memory.
const CHANNELS: usize = 4;

/// Sizes of a batch of square images cut into square patches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PatchShape {
    /// Images.
    pub batch: usize,
    /// Side of an image in pixels.
    pub side_px: usize,
    /// Side of a patch in pixels; pixels past the last whole patch are dropped.
    pub patch_px: usize,
}

impl PatchShape {
    /// Rows per image: one for the class token, one per patch.
    #[must_use]
    pub fn tokens(&self) -> usize {
        1 + (self.side_px / self.patch_px).pow(2)
    }

    /// Elements of a row.
    #[must_use]
    pub fn row_len(&self) -> usize {
        self.patch_px * self.patch_px * CHANNELS
    }

    /// Elements of the images.
    #[must_use]
    pub fn pixels_len(&self) -> usize {
        self.batch * self.side_px * self.side_px * CHANNELS
    }

    /// Elements of all rows.
    #[must_use]
    pub fn rows_len(&self) -> usize {
        self.batch * self.tokens() * self.row_len()
    }

    fn check(&self, pixels: usize, rows: usize) -> Result<(), KernelError> {
        if self.patch_px == 0 || self.patch_px > self.side_px {
            let expected = format!("1..={}", self.side_px);
            return Err(shape_error(KERNEL, "patch_px", self.patch_px.to_string(), expected));
        }
        expect_len(KERNEL, "pixels", pixels, self.pixels_len(), "batch*side*side*4")?;
        expect_len(KERNEL, "rows", rows, self.rows_len(), "batch*tokens*patch*patch*4")
    }
}

/// Cuts images into rows; the product of a row with the patch weights is the patch embedding.
///
/// # Shapes
/// in `pixels` \[B, side, side, 4\], the fourth channel is ignored · out `rows` \[B*tokens, patch*patch*4\] (=), row 0
/// of each image zero, fourth channel zero
/// # Equation: im2col with stride = patch; Dosovitskiy et al. 2021, eq. 1
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn unfold(
    rec: &mut Recorder,
    shape: PatchShape,
    pixels: &Buffer<f32>,
    rows: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    shape.check(pixels.len(), rows.len())?;
    let total = rows.len() / CHANNELS;
    let params = patch_embed_unfold::Params {
        total: as_u32(total),
        side: as_u32(shape.side_px),
        patch_px: as_u32(shape.patch_px),
    };
    rec.dispatch(patch_embed_unfold::Bind { pixels_tex: pixels, rows }, params, Grid::threads(total))
}

/// Adjoint of [`unfold`].
///
/// # Shapes
/// in `v_rows` \[B*tokens, patch*patch*4\] · out `v_pixels` \[B, side, side, 4\] (=), fourth channel zero
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn fold(
    rec: &mut Recorder,
    shape: PatchShape,
    v_rows: &Buffer<f32>,
    v_pixels: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    shape.check(v_pixels.len(), v_rows.len())?;
    let total = v_pixels.len() / CHANNELS;
    let params = patch_embed_fold::Params {
        total: as_u32(total),
        side: as_u32(shape.side_px),
        patch_px: as_u32(shape.patch_px),
    };
    rec.dispatch(patch_embed_fold::Bind { v_rows_tex: v_rows, v_pixels }, params, Grid::threads(total))
}
