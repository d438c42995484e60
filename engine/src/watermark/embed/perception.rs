//! LPIPS in a training step. The reference's features are computed again each time: kept, they would take several times the
//! memory of the clip itself.

use guard4d_kernels::image::resize::ImageSize;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::config::EmbedConfig;
use crate::error::EngineError;
use crate::lpips::{Lpips, LpipsPass, Pair};
use crate::watermark::extractor::CLIP_FRAMES;

/// The network with room for the part of a clip that a step compares.
pub(super) struct Perception {
    net: Lpips,
    pass: LpipsPass,
    frame: ImageSize,
    /// Factor on the gradient of a step that compares: for all those until the next one.
    weight: f32,
}

impl Perception {
    /// `None` when LPIPS is no part of the loss.
    pub(super) fn new(device: &Device, config: &EmbedConfig) -> Result<Option<Self>, EngineError> {
        let Some(term) = config.trained_lpips() else { return Ok(None) };
        let net = Lpips::new(device, &term.weights, term.input)?;
        let frame = config.frame_size();
        let pass = net.pass(term.part_of(frame), CLIP_FRAMES)?;
        Ok(Some(Self { net, pass, frame, weight: term.lambda * term.every as f32 }))
    }

    /// Compares the part from `corner` on, and adds its gradient.
    pub(super) fn step(
        &mut self,
        rec: &mut Recorder,
        (image, reference): (&Buffer<f32>, &Buffer<f32>),
        corner: [usize; 2],
        v_image: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        let pair = Pair { image, reference, full: self.frame, corner };
        self.net.step(rec, &mut self.pass, &pair, Some((v_image, self.weight)))
    }

    /// What a step leaves for [`Perception::score`].
    pub(super) fn values(&self) -> &Buffer<f32> {
        self.pass.values()
    }

    /// The distance that `values` say.
    #[allow(clippy::cast_possible_truncation, reason = "as the other losses")]
    pub(super) fn score(&self, values: &[f32]) -> f32 {
        self.pass.score(values).total() as f32
    }
}
