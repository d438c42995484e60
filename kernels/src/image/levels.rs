//! Pixels of 8 bits, a word each: a quarter of the memory of numbers.

use super::frames::CHANNELS;
use crate::error::KernelError;
use crate::registry::image::{levels_pack, levels_unpack};
use crate::shape::{dim, expect_len};
use crate::vk::{Buffer, Grid, Recorder};

/// Clamps to \[0, 1\] and rounds to 8 bits, halves up. What [`unpack`] makes of the colours is, to the bit, what
/// [`quantize::forward`] makes of them; the fourth channel is rounded as well.
///
/// [`quantize::forward`]: super::quantize::forward
///
/// # Shapes
/// in `x` \[n,4\] · out `levels` \[n\] (=), first channel lowest
/// # Equation: ⌊255 x + ½⌋; 0 for NaN
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn pack(rec: &mut Recorder, x: &Buffer<f32>, levels: &mut Buffer<u32>) -> Result<(), KernelError> {
    let n = levels.len();
    expect_len("image/levels", "x", x, n * CHANNELS)?;
    rec.dispatch(levels_pack::Bind { x, levels }, levels_pack::Params { n: dim(n) }, Grid::threads(n))
}

/// Takes out what [`pack`] put in.
///
/// # Shapes
/// in `levels` \[n\] · out `y` \[n,4\] (=), multiples of 1/255
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn unpack(rec: &mut Recorder, levels: &Buffer<u32>, y: &mut Buffer<f32>) -> Result<(), KernelError> {
    let n = levels.len();
    expect_len("image/levels", "y", y, n * CHANNELS)?;
    rec.dispatch(levels_unpack::Bind { levels, y }, levels_unpack::Params { n: dim(n) }, Grid::threads(n))
}
