//! What a step takes beside its clip.

use guard4d_kernels::image::noise::Noise;
use rand_chacha::ChaCha20Rng;

use super::config::EmbedConfig;
use super::config::turns::ControlTurn;
use super::draw::unit;
use crate::picture::distortion::Drawn;

/// Rates, scales and draws of one step.
#[derive(Clone, Copy, Debug)]
pub(super) struct StepInputs {
    /// Factor on both learning rates.
    pub(super) decay: f32,
    /// Factor on the offsets that holds the fidelity.
    pub(super) offset_scale: f32,
    /// Noise of the noisy control.
    pub(super) noise: Noise,
    /// Control that the step reads, if it trains R.
    pub(super) control: ControlTurn,
    /// First row and column of what is compared by LPIPS, in the steps that do.
    pub(super) crop: Option<[usize; 2]>,
    /// What both clips go through before CLIP sees them.
    pub(super) distortion: Option<Drawn>,
}

impl StepInputs {
    /// Those of step number `step`, from its own random stream.
    pub(super) fn draw(
        config: &EmbedConfig,
        step: usize,
        decay: f32,
        offset_scale: f32,
        rng: &mut ChaCha20Rng,
    ) -> Self {
        let (low, high) = config.objective.noise_sigma;
        let sigma = low * (high / low).powf(unit(rng));
        Self {
            decay,
            offset_scale,
            noise: Noise { sigma, seed: config.seed, stream: u32::try_from(step).unwrap_or(u32::MAX) },
            control: config.control_turn(step),
            crop: config.lpips_turn(step, rng),
            distortion: config.distortion_turn(step, rng),
        }
    }
}
