//! Rounding to 8 bits.

use super::frames::CHANNELS;
use crate::error::KernelError;
use crate::registry::image::quantize_round;
use crate::shape::{dim, expect_len};
use crate::vk::{Buffer, Grid, Recorder};

/// Clamps to \[0, 1\] and rounds to multiples of 1/255, halves up. Training takes its gradient as the
/// identity, so there is no backward pass.
///
/// # Shapes
/// in `x` \[n,4\] · out `y` \[n,4\] (=); the fourth channel is copied
/// # Equation: ⌊255 x + ½⌋ / 255
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(rec: &mut Recorder, x: &Buffer<f32>, y: &mut Buffer<f32>) -> Result<(), KernelError> {
    expect_len("image/quantize", "y", y, x.len())?;
    let n = x.len() / CHANNELS;
    rec.dispatch(quantize_round::Bind { x, y }, quantize_round::Params { n: dim(n) }, Grid::threads(n))
}
