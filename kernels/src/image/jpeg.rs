//! The loss of a JPEG file, with a gradient that passes the rounding.

use super::chroma420::{self, JFIF, inverse};
use super::frames::{expect_frames, frames_grid, two_maps};
use crate::error::KernelError;
use crate::registry::image::{jpeg_fwd, jpeg_fwd_tile};
use crate::shape::ClipShape;
use crate::vk::{Buffer, Device, KernelFamily, Recorder};

const KERNEL: &str = "image/jpeg";
/// Pixels along a side of what is coded together: two blocks of luma, one of chroma.
const UNIT_PX: usize = 16;

/// Quantisation steps at quality 50 (ITU-T T.81 Annex K, Tables K.1 and K.2), luma then chroma, row by row.
const STEPS: [[u16; 64]; 2] = [
    [
        16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29,
        51, 87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92, 49, 64, 78, 87, 103, 121,
        120, 101, 72, 92, 95, 98, 112, 100, 103, 99,
    ],
    [
        17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99, 99, 99, 47, 66, 99, 99,
        99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
        99, 99, 99, 99, 99, 99, 99, 99,
    ],
];

/// Quantisation steps of a quality, as libjpeg scales them.
#[must_use]
pub fn steps(quality: u8) -> Vec<f32> {
    let quality = u32::from(quality.clamp(1, 100));
    let percent = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    let scaled = |step: u16| ((u32::from(step) * percent + 50) / 100).clamp(1, 255);
    STEPS.iter().flatten().map(|step| scaled(*step) as f32).collect()
}

/// A quality, ready on the device.
#[derive(Debug)]
pub struct JpegQuality {
    steps: Buffer<f32>,
}

impl JpegQuality {
    /// Uploads the steps of a quality from 1 to 100.
    ///
    /// # Errors
    /// When memory runs out.
    pub fn new(device: &Device, quality: u8) -> Result<Self, KernelError> {
        Ok(Self { steps: device.buffer_from("jpeg.steps", &steps(quality))? })
    }
}

/// Codes and decodes every frame with 4:2:0 chroma.
///
/// # Shapes
/// in `x` \[F,H,W,4\] in \[0, 1\] · out `y` likewise (=), neither clamped nor rounded to 8 bits, fourth channel 0
/// # Equation: baseline JPEG (ITU-T T.81) without its entropy coding, which loses nothing; chroma is averaged over
/// quads and repeated, borders repeat the last pixel
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    clip: ClipShape,
    quality: &JpegQuality,
    x: &Buffer<f32>,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    expect_frames(KERNEL, clip, [("x", x), ("y", y)])?;
    let units = clip.height.div_ceil(UNIT_PX) * clip.width.div_ceil(UNIT_PX);
    match rec.family() {
        KernelFamily::Lanes => {
            let params = two_maps!(jpeg_fwd, clip, JFIF, inverse(&JFIF));
            let grid = frames_grid(units, clip.frames, jpeg_fwd::KERNEL.local_size[0]);
            rec.dispatch(jpeg_fwd::Bind { x, quant: &quality.steps, y }, params, grid)
        }
        KernelFamily::Tiles => {
            let params = two_maps!(jpeg_fwd_tile, clip, JFIF, inverse(&JFIF));
            let grid = frames_grid(units, clip.frames, 1);
            rec.dispatch(jpeg_fwd_tile::Bind { x, quant: &quality.steps, y }, params, grid)
        }
    }
}

/// Gradient to the input with the rounding taken for the identity (a straight-through estimate): what is left of the
/// coder is the averaging of chroma, since the transform and its inverse cancel.
///
/// # Shapes
/// in `v_y` \[F,H,W,4\] · out `v_x` likewise (=), fourth channel 0
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
    chroma420::backward(rec, clip, v_y, v_x)
}
