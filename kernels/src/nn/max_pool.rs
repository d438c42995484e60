//! Largest values of square windows.

use super::check::{as_u32, expect_len, expect_multiple, shape_error};
use crate::error::KernelError;
use crate::registry::nn::{max_pool_bwd, max_pool_fwd};
use crate::shape::require_len;
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "nn/max_pool";

/// Sizes of one pooling.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MaxPool {
    /// Images.
    pub frames: usize,
    /// Of an input image.
    pub height: usize,
    /// Of an input image.
    pub width: usize,
    /// A multiple of 4.
    pub channels: usize,
    /// Side of a window in pixels.
    pub side: usize,
    /// Pixels from one window to the next.
    pub stride: usize,
}

impl MaxPool {
    /// Height and width of an output image: windows that lie whole inside the image; 0 where none does.
    #[must_use]
    pub fn out_size(&self) -> (usize, usize) {
        let outputs = |size: usize| size.checked_sub(self.side).map_or(0, |rest| rest / self.stride + 1);
        (outputs(self.height), outputs(self.width))
    }

    /// Elements of the input and of the output.
    #[must_use]
    pub fn lens(&self) -> (usize, usize) {
        let (height, width) = self.out_size();
        let per_pixel = self.frames * self.channels;
        (per_pixel * self.height * self.width, per_pixel * height * width)
    }

    fn check(&self) -> Result<(), KernelError> {
        expect_multiple(KERNEL, "channels", self.channels, 4)?;
        if self.side > 0 && self.stride > 0 && self.out_size().0 > 0 && self.out_size().1 > 0 {
            return Ok(());
        }
        let got = format!("{} every {} in {} x {}", self.side, self.stride, self.height, self.width);
        Err(shape_error(KERNEL, "side", got, "windows within the image".to_owned()))
    }
}

/// `y` = the largest value of each window, per channel; NaN where the window has one.
///
/// # Shapes
/// in `x` \[F, H, W, C\] · out `y` \[F, H', W', C\] (=), see [`MaxPool::out_size`]
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(rec: &mut Recorder, pool: &MaxPool, x: &Buffer<f32>, y: &mut Buffer<f32>) -> Result<(), KernelError> {
    pool.check()?;
    let (x_len, y_len) = pool.lens();
    expect_len(KERNEL, "x", x.len(), x_len, "F*H*W*C")?;
    expect_len(KERNEL, "y", y.len(), y_len, "F*H'*W'*C")?;
    let (out_height, out_width) = pool.out_size();
    let params = max_pool_fwd::Params {
        total: as_u32(y_len / 4),
        height: as_u32(pool.height),
        width: as_u32(pool.width),
        out_height: as_u32(out_height),
        out_width: as_u32(out_width),
        channels4: as_u32(pool.channels / 4),
    };
    let spec = max_pool_fwd::Spec { side: as_u32(pool.side), stride: as_u32(pool.stride) };
    rec.dispatch_spec(max_pool_fwd::Bind { x_tex: x, y }, params, spec, Grid::threads(y_len / 4))
}

/// Gradient to the input: that of a window goes to its largest value, which is found again.
///
/// # Shapes
/// in `x` \[F, H, W, C\] or longer (the forward pass's input) · `v_y` \[F, H', W', C\] · out `v_x` \[F, H, W, C\] (=)
/// # Equation: as `PyTorch`'s: of equal values the first in row-major order counts, of several NaN the last
/// # Determinism: bitwise; an input adds up the windows over it in order, no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    pool: &MaxPool,
    x: &Buffer<f32>,
    v_y: &Buffer<f32>,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    pool.check()?;
    let (x_len, y_len) = pool.lens();
    require_len(KERNEL, "x", x.len(), x_len)?;
    expect_len(KERNEL, "v_y", v_y.len(), y_len, "F*H'*W'*C")?;
    expect_len(KERNEL, "v_x", v_x.len(), x_len, "F*H*W*C")?;
    let (out_height, out_width) = pool.out_size();
    let params = max_pool_bwd::Params {
        total: as_u32(x_len / 4),
        height: as_u32(pool.height),
        width: as_u32(pool.width),
        out_height: as_u32(out_height),
        out_width: as_u32(out_width),
        channels4: as_u32(pool.channels / 4),
    };
    let spec = max_pool_bwd::Spec { side: as_u32(pool.side), stride: as_u32(pool.stride) };
    rec.dispatch_spec(max_pool_bwd::Bind { x_tex: x, v_y_tex: v_y, v_x }, params, spec, Grid::threads(x_len / 4))
}
