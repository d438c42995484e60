//! What a step loses by changing the picture.

use guard4d_kernels::loss::pixel::{self, PixelWeights};
use guard4d_kernels::loss::ssim::{self, SsimPair, SsimScratch};
use guard4d_kernels::loss::sum::SumScratch;
use guard4d_kernels::loss::{PixelPair, Term};
use guard4d_kernels::shape::Accumulate;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::buffers::{MarkedFrames, TrainingBuffers};
use super::config::EmbedConfig;
use super::training_clip::TrainingClip;
use crate::watermark::extractor::weights::CLIP_FRAMES;
use crate::watermark::step_part::StepPart;

/// Slots of the values; `loss/pixel` fills the first two in this order.
pub(super) const MSE: usize = 0;
pub(super) const L1: usize = 1;
pub(super) const DISSIMILARITY: usize = 2;
/// Of the penalty on offsets.
pub(super) const OFFSET: usize = 3;
pub(super) const NUM_VALUES: usize = 4;

/// Distances of marked frames from unmarked ones.
pub(super) struct FidelityLoss {
    /// One for each slot.
    pub(super) values: Buffer<f32>,
    sums: SumScratch,
    /// Working memory for SSIM, when it is part of the loss.
    similarity: Option<SsimScratch>,
}

impl FidelityLoss {
    /// # Errors
    /// When memory runs out.
    pub(super) fn new(device: &Device, config: &EmbedConfig) -> Result<Self, KernelError> {
        let size = config.views.frame_size();
        Ok(Self {
            values: device.buffer("loss.values", NUM_VALUES)?,
            sums: SumScratch::new(device, CLIP_FRAMES * size.height * size.width)?,
            similarity: match config.objective.uses_ssim() {
                true => Some(SsimScratch::new(device, size, CLIP_FRAMES)?),
                false => None,
            },
        })
    }

    /// Reconstruction loss, with its gradient beside the marked frames where that is wanted, and the squared error.
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub(super) fn record(
        &mut self,
        rec: &mut Recorder,
        buffers: &mut TrainingBuffers,
        clip: &TrainingClip,
        config: &EmbedConfig,
    ) -> Result<(), KernelError> {
        let MarkedFrames { frames, unmarked, gradient } = buffers.marked();
        let objective = &config.objective;
        let Self { values, sums, similarity } = self;
        let num_px = frames.len() / 4;
        let pair = PixelPair { image: frames, image_px: 0, reference: unmarked, reference_px: 0, num_px };
        // The squared error is only measured: the fidelity is held by scaling the offsets.
        let weights = PixelWeights { square: 0.0, absolute: 1.0 - objective.lambda_ssim };
        StepPart::Losses.record(rec, |rec| {
            let term = Term { values, slot: MSE, weight: objective.lambda_recon, accumulate: Accumulate::Overwrite };
            pixel::step(rec, &pair, weights, Some(&mut *gradient).filter(|v| !v.is_empty()), term, sums)?;
            if let (Some(moments), Some(scratch)) = (&clip.moments, similarity) {
                let pair = SsimPair { clip: frames, reference: unmarked, moments };
                let weight = objective.lambda_recon * objective.lambda_ssim;
                let term = Term { values, slot: DISSIMILARITY, weight, accumulate: Accumulate::Add };
                ssim::step(rec, &pair, gradient, term, scratch)?;
            }
            Ok(())
        })
    }
}
