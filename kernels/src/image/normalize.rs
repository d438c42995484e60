//! Per-channel normalisation.

use super::frames::CHANNELS;
use crate::error::KernelError;
use crate::registry::image::{normalize_bwd, normalize_fwd};
use crate::shape::{dim, expect_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "image/normalize";

/// Mean and standard deviation of each colour channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normalization {
    /// Subtracted.
    pub mean: [f32; 3],
    /// Divided by.
    pub std: [f32; 3],
}

/// Normalises a clip.
///
/// # Shapes
/// in `x` \[n,4\] · out `y` \[n,4\] (=), fourth channel 0
/// # Equation: (x − mean) / std
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    by: &Normalization,
    x: &Buffer<f32>,
    y: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    expect_len(KERNEL, "y", y, x.len())?;
    let n = x.len() / CHANNELS;
    let ([mean_r, mean_g, mean_b], [std_r, std_g, std_b]) = (by.mean, by.std);
    let params = normalize_fwd::Params { n: dim(n), mean_r, mean_g, mean_b, std_r, std_g, std_b };
    rec.dispatch(normalize_fwd::Bind { x, y }, params, Grid::threads(n))
}

/// Gradient to the input.
///
/// # Shapes
/// in `v_y` \[n,4\] · out `v_x` \[n,4\] (=), fourth channel 0
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    by: &Normalization,
    v_y: &Buffer<f32>,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    expect_len(KERNEL, "v_x", v_x, v_y.len())?;
    let n = v_y.len() / CHANNELS;
    let [std_r, std_g, std_b] = by.std;
    let params = normalize_bwd::Params { n: dim(n), std_r, std_g, std_b };
    rec.dispatch(normalize_bwd::Bind { v_y, v_x }, params, Grid::threads(n))
}
