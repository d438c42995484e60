//! Training clips: what of a view and its frames never changes while colours do.

use std::sync::Arc;

use guard4d_kernels::image::clamp01;
use guard4d_kernels::image::resize::{self, ResizePlan};
use guard4d_kernels::loss::ssim::{self, SsimReference, SsimScratch};
use guard4d_kernels::{Buffer, Device};

use crate::deform::DeformField;
use crate::error::EngineError;
use crate::render::{FramePlan, Prune, Renderer};
use crate::scene::Camera;

/// [`crate::watermark::extractor::CLIP_FRAMES`] frames that are trained on together.
#[derive(Debug)]
pub(super) struct TrainingClip {
    pub(super) plans: Vec<Arc<FramePlan>>,
    /// Unmarked frames `[F,H,W,4]` in [0, 1].
    pub(super) reference: Buffer<f32>,
    /// The same at CLIP's size.
    pub(super) resized: Buffer<f32>,
    /// Reference moments for SSIM, when it is part of the loss.
    pub(super) moments: Option<SsimReference>,
}

/// What building a clip needs.
pub(super) struct ClipBuilder<'a> {
    pub(super) device: &'a Device,
    pub(super) field: &'a mut DeformField,
    pub(super) renderer: &'a mut Renderer,
    pub(super) resize: &'a ResizePlan,
    pub(super) background: [f32; 3],
    /// Working memory for [`TrainingClip::moments`], when they are wanted.
    pub(super) similarity: Option<SsimScratch>,
}

impl ClipBuilder<'_> {
    /// Plans and renders one clip.
    pub(super) fn build(&mut self, shots: &[(Camera, f32)]) -> Result<TrainingClip, EngineError> {
        let mut plans = Vec::with_capacity(shots.len());
        for (camera, time) in shots {
            let state = self.field.at(*time)?;
            plans.push(Arc::new(self.renderer.plan(&state, camera, Prune::Remove)?));
        }
        let frames = shots.len();
        let (from, to) = (self.resize.from, self.resize.to);
        let full = frames * from.height * from.width * 4;
        let mut raw = self.device.buffer("clip.raw", full)?;
        let mut reference = self.device.buffer("clip.reference", full)?;
        let mut resized = self.device.buffer("clip.resized", frames * to.height * to.width * 4)?;
        let mut scratch = self.resize.scratch(self.device, frames)?;
        let mut rec = self.device.recorder()?;
        self.renderer.forward_clip(&mut rec, &plans, None, self.background, &mut raw)?;
        clamp01::forward(&mut rec, &raw, &mut reference)?;
        resize::forward(&mut rec, self.resize, &reference, &mut resized, &mut scratch)?;
        let moments = match &mut self.similarity {
            Some(scratch) => {
                let mut moments = SsimReference::new(self.device, from, frames)?;
                ssim::prepare(&mut rec, &reference, &mut moments, scratch)?;
                Some(moments)
            }
            None => None,
        };
        rec.submit()?;
        Ok(TrainingClip { plans, reference, resized, moments })
    }
}
