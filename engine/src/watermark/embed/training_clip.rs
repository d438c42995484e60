//! One clip of an embedding: what of its views and frames never changes while colours do.

use std::sync::{Arc, OnceLock};

use guard4d_kernels::Buffer;
use guard4d_kernels::loss::ssim::SsimReference;

use crate::networks::lpips::LpipsFeatures;
use crate::render::FramePlan;

/// [`CLIP_FRAMES`] frames that are trained on, or evaluated, together.
///
/// [`CLIP_FRAMES`]: crate::watermark::extractor::weights::CLIP_FRAMES
#[derive(Debug)]
pub(super) struct TrainingClip {
    pub(super) plans: Vec<Arc<FramePlan>>,
    /// Unmarked frames, rounded to 8 bits as a video holds them: a word of four levels for each pixel `[F,H,W]`.
    pub(super) unmarked: Buffer<u32>,
    /// Reference moments for SSIM, when it is part of the loss.
    pub(super) moments: Option<SsimReference>,
    /// What LPIPS's network sees in the unmarked frames, once a step has computed it where there is room to keep it.
    pub(super) features: OnceLock<LpipsFeatures>,
}

impl TrainingClip {
    /// Device bytes, but for LPIPS's features; the scene's coefficients are shared and not counted.
    pub(super) fn bytes(&self) -> u64 {
        let plans: usize = self.plans.iter().map(|plan| plan.bytes()).sum();
        let frames = size_of::<u32>() * self.unmarked.len();
        (plans + frames + self.moments.as_ref().map_or(0, SsimReference::bytes)) as u64
    }
}
