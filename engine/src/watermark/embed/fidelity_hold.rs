//! Holding the fidelity by scaling the offsets.

use super::config::{EmbedConfig, Fidelity};

/// Weight of the newest step in the running mean of the squared error.
const MSE_SHARE: f32 = 0.2;

/// The squared error as steps see it, and what that means for the offsets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FidelityHold {
    /// Running mean; none before the first step.
    pub(super) mean_mse: Option<f32>,
    /// Factor on the offsets in the next step.
    pub(super) offset_scale: f32,
}

impl Default for FidelityHold {
    fn default() -> Self {
        Self { mean_mse: None, offset_scale: 1.0 }
    }
}

impl FidelityHold {
    /// Chooses the factor for the next step so that the running squared error stays at the target.
    pub(super) fn note(&mut self, config: &EmbedConfig, step: usize, mse: f32) {
        let Fidelity { target_psnr, start_psnr, .. } = config.fidelity;
        // The value was measured before this step's factor took effect.
        let mse = mse * self.offset_scale * self.offset_scale;
        let mean = self.mean_mse.map_or(mse, |mean| mean + MSE_SHARE * (mse - mean));
        let progress = (2.0 * step as f32 / config.optimiser.steps as f32).min(1.0);
        let asked = start_psnr + (target_psnr - start_psnr) * progress;
        let allowed = 10f32.powf(-0.1 * config.fidelity.of_mark(asked));
        self.offset_scale = if mean > allowed { (allowed / mean).sqrt() } else { 1.0 };
        self.mean_mse = Some(mean * self.offset_scale * self.offset_scale);
    }
}
