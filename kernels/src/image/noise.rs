//! Reproducible Gaussian noise on colours, then the clamp to \[0, 1\].

use super::frames::CHANNELS;
use crate::error::KernelError;
use crate::registry::image::{noise_bwd, noise_fwd};
use crate::shape::{dim, expect_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "image/noise";

/// Strength of the noise and which noise it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation on the \[0, 1\] scale.
    pub sigma: f32,
    /// Seed of the run.
    pub seed: u64,
    /// Number of the draw, such as the step: another stream is another noise.
    pub stream: u32,
}

impl Noise {
    #[allow(clippy::cast_possible_truncation, reason = "the seed is handed over in two halves")]
    fn seed_words(self) -> (u32, u32) {
        (self.seed as u32, (self.seed >> 32) as u32)
    }
}

/// Adds noise and clamps.
///
/// # Shapes
/// in `x` \[n,4\] · out `y` \[n,4\] (=); the fourth channel is copied
/// # Equation: clamp(x + σ·z), z from PCG4D (Jarzynski & Olano 2020) by Box and Muller
/// # Determinism: a function of pixel index, stream and seed; one driver gives the same bits
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(rec: &mut Recorder, noise: &Noise, x: &Buffer<f32>, y: &mut Buffer<f32>) -> Result<(), KernelError> {
    expect_len(KERNEL, "y", y, x.len())?;
    let n = x.len() / CHANNELS;
    let (seed_low, seed_high) = noise.seed_words();
    let params = noise_fwd::Params { n: dim(n), sigma: noise.sigma, stream: noise.stream, seed_low, seed_high };
    rec.dispatch(noise_fwd::Bind { x, y }, params, Grid::threads(n))
}

/// Gradient to the input: passes where the noisy colour lies in \[0, 1\].
///
/// # Shapes
/// in `x` \[n,4\] as given to [`forward`] · `v_y` \[n,4\] · out `v_x` \[n,4\] (=), fourth channel 0
/// # Determinism: as [`forward`], whose noise is drawn again
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    noise: &Noise,
    x: &Buffer<f32>,
    v_y: &Buffer<f32>,
    v_x: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    expect_len(KERNEL, "v_y", v_y, x.len())?;
    expect_len(KERNEL, "v_x", v_x, x.len())?;
    let n = x.len() / CHANNELS;
    let (seed_low, seed_high) = noise.seed_words();
    let params = noise_bwd::Params { n: dim(n), sigma: noise.sigma, stream: noise.stream, seed_low, seed_high };
    rec.dispatch(noise_bwd::Bind { x, v_y, v_x }, params, Grid::threads(n))
}
