//! Offsets, renderer and full-size clip buffers of training, and what each holds when.

use guard4d_kernels::image::noise::{self, Noise};
use guard4d_kernels::image::resize::{ImageSize, Onward, ResizePlan};
use guard4d_kernels::image::{levels, quantize};
use guard4d_kernels::shape::OffsetBases;
use guard4d_kernels::splat::tile_bin::Prune;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::config::EmbedConfig;
use super::copies::Copies;
use super::offsets::TrainedOffsets;
use super::training_clip::TrainingClip;
use crate::error::EngineError;
use crate::picture::distortion::{DistortionLayer, Drawn, Resizer};
use crate::render::deform::SplatState;
use crate::render::{FramePlan, Renderer};
use crate::scene::{Camera, Model};
use crate::watermark::extractor::weights::CLIP_FRAMES;
use crate::watermark::step_part::StepPart;

/// Offsets, renderer and full-size clip buffers, one clip at a time.
///
/// A step writes `unmarked`, `raw` and `marked`, then `resized` and, of its control, `control`; its way back writes
/// `v_marked`, `v_raw` and the offsets' gradient. Between steps all but the offsets is free, so that clips are made,
/// and the extractor is fitted, in the same memory. Within a step `v_raw` is free until the way back, and `marked` is
/// not once losses that look at pixels have seen it and it is resized: controls are made in these two.
pub(super) struct TrainingBuffers {
    pub(super) offsets: TrainedOffsets,
    renderer: Renderer,
    resizer: Resizer,
    size: ImageSize,
    background: [f32; 3],
    /// Unmarked frames of the clip at hand, rounded `[F,H,W,4]`.
    unmarked: Buffer<f32>,
    /// Marked frames as they are rendered `[F,H,W,4]`.
    raw: Buffer<f32>,
    /// The same clamped and rounded, as a video holds them.
    marked: Buffer<f32>,
    /// Gradient of the losses that look at pixels; empty when none has a weight.
    v_marked: Buffer<f32>,
    /// Gradient of the render.
    v_raw: Buffer<f32>,
    /// Marked frames at CLIP's size `[F,S,S,4]`.
    resized: Buffer<f32>,
    /// Unmarked frames of a control at that size.
    control: Buffer<f32>,
    /// Room for distorted clips, where training has some.
    copies: Option<Copies>,
}

/// Marked frames, what they are compared with, and where their gradient goes, if a loss looks at pixels.
pub(super) struct MarkedFrames<'a> {
    pub(super) frames: &'a Buffer<f32>,
    pub(super) unmarked: &'a Buffer<f32>,
    pub(super) gradient: &'a mut Buffer<f32>,
}

impl TrainingBuffers {
    /// Zero offsets on `model`, and room for clips that CLIP sees at `side` × `side` pixels.
    pub(super) fn new(device: &Device, model: &Model, config: &EmbedConfig, side: usize) -> Result<Self, EngineError> {
        let size = config.views.frame_size();
        let plan = ResizePlan::new(device, size, ImageSize { height: side, width: side })?;
        let full = |name: &str| device.buffer(&format!("buffers.{name}"), CLIP_FRAMES * size.height * size.width * 4);
        let small = |name: &str| device.buffer(&format!("buffers.{name}"), CLIP_FRAMES * side * side * 4);
        let looks_at_pixels = config.objective.looks_at_pixels();
        Ok(Self {
            renderer: Renderer::new(device)?,
            resizer: Resizer::new(device, CLIP_FRAMES, plan)?,
            size,
            background: model.background,
            offsets: TrainedOffsets::new(device, model, config.fidelity.bases)?,
            unmarked: full("unmarked")?,
            raw: full("raw")?,
            marked: full("marked")?,
            v_marked: if looks_at_pixels { full("v_marked")? } else { device.buffer("buffers.v_marked", 0)? },
            v_raw: full("v_raw")?,
            resized: small("resized")?,
            control: small("control")?,
            copies: Copies::new(device, config)?,
        })
    }

    /// Size of the frames.
    pub(super) fn frame_size(&self) -> ImageSize {
        self.size
    }

    /// Pixels of a clip.
    pub(super) fn num_pixels(&self) -> usize {
        CLIP_FRAMES * self.size.height * self.size.width
    }

    /// What of a view never changes while its colours do.
    pub(super) fn plan(&mut self, state: &SplatState, camera: &Camera, prune: Prune) -> Result<FramePlan, EngineError> {
        let plan = self.renderer.plan(state, camera, prune)?;
        Ok(match self.offsets.bases() {
            OffsetBases::Dc => self.renderer.fix_view(plan)?,
            OffsetBases::All => plan,
        })
    }

    /// Unmarked frames of `clip`, rounded, for it to keep, between steps.
    pub(super) fn draw_unmarked(&mut self, rec: &mut Recorder, clip: &mut TrainingClip) -> Result<(), EngineError> {
        self.renderer.forward_clip(rec, &clip.plans, None, self.background, &mut self.raw)?;
        levels::pack(rec, &self.raw, &mut clip.unmarked)?;
        Ok(self.unpack_unmarked(rec, clip)?)
    }

    /// Takes out the unmarked frames of a clip.
    fn unpack_unmarked(&mut self, rec: &mut Recorder, clip: &TrainingClip) -> Result<(), KernelError> {
        StepPart::Image.record(rec, |rec| levels::unpack(rec, &clip.unmarked, &mut self.unmarked))
    }

    /// The unmarked frames of the clip that was drawn last.
    pub(super) fn unmarked(&self) -> &Buffer<f32> {
        &self.unmarked
    }

    /// Marked frames of a clip, clamped and rounded as a video holds them, and its unmarked frames. Rounding passes its
    /// gradient through, clamping does not.
    pub(super) fn draw(&mut self, rec: &mut Recorder, clip: &TrainingClip) -> Result<(), EngineError> {
        self.unpack_unmarked(rec, clip)?;
        let offsets = self.offsets.as_rendered();
        StepPart::RenderForward.record(rec, |rec| {
            self.renderer.forward_clip(rec, &clip.plans, Some(offsets), self.background, &mut self.raw)
        })?;
        StepPart::Image.record(rec, |rec| quantize::forward(rec, &self.raw, &mut self.marked))?;
        Ok(())
    }

    /// The marked frames at CLIP's size, distorted if the step says so.
    pub(super) fn shrink(&mut self, rec: &mut Recorder, distortion: Option<Drawn>) -> Result<(), KernelError> {
        let Self { marked, resizer, resized, copies, .. } = self;
        StepPart::Image.record(rec, |rec| match (copies, distortion) {
            (Some(copies), Some(drawn)) => copies.forward(rec, drawn, marked, resizer, resized),
            _ => resizer.forward(rec, marked, resized),
        })
    }

    /// Marked frames of a clip, also at CLIP's size.
    pub(super) fn render(&mut self, rec: &mut Recorder, clip: &TrainingClip) -> Result<(), EngineError> {
        self.draw(rec, clip)?;
        Ok(self.shrink(rec, None)?)
    }

    /// The marked and the unmarked frames, and room for the gradient of the marked ones.
    pub(super) fn marked(&mut self) -> MarkedFrames<'_> {
        MarkedFrames { frames: &self.marked, unmarked: &self.unmarked, gradient: &mut self.v_marked }
    }

    /// The marked frames at CLIP's size.
    pub(super) fn resized(&self) -> &Buffer<f32> {
        &self.resized
    }

    /// The control at CLIP's size.
    pub(super) fn control(&self) -> &Buffer<f32> {
        &self.control
    }

    /// The unmarked frames of any clip, as the control.
    pub(super) fn clean_control(&mut self, rec: &mut Recorder, clip: &TrainingClip) -> Result<(), KernelError> {
        self.unpack_unmarked(rec, clip)?;
        StepPart::Image.record(rec, |rec| self.resizer.forward(rec, &self.unmarked, &mut self.control))
    }

    /// The unmarked frames with noise, rounded before they are resized, as the control.
    pub(super) fn noisy_control(
        &mut self,
        rec: &mut Recorder,
        clip: &TrainingClip,
        noise: &Noise,
    ) -> Result<(), KernelError> {
        self.unpack_unmarked(rec, clip)?;
        StepPart::Image.record(rec, |rec| {
            noise::forward(rec, noise, &self.unmarked, &mut self.v_raw)?;
            self.shrink_control(rec)
        })
    }

    /// The unmarked frames, distorted as the marked ones are, as the control.
    pub(super) fn distorted_control(
        &mut self,
        rec: &mut Recorder,
        clip: &TrainingClip,
        drawn: Drawn,
    ) -> Result<(), KernelError> {
        self.unpack_unmarked(rec, clip)?;
        let Self { copies, resizer, unmarked, v_raw, control, .. } = self;
        let Some(copies) = copies else { return Ok(()) };
        StepPart::Image.record(rec, |rec| {
            copies.distort(rec, drawn, unmarked, v_raw)?;
            copies.shrink(rec, v_raw, resizer, control)
        })
    }

    /// The unmarked frames distorted by a layer that is not training's own, as the control.
    pub(super) fn copy_control(
        &mut self,
        rec: &mut Recorder,
        clip: &TrainingClip,
        layer: &mut DistortionLayer,
        drawn: Drawn,
    ) -> Result<(), KernelError> {
        self.unpack_unmarked(rec, clip)?;
        layer.forward(rec, drawn, &self.unmarked, &mut self.v_raw)?;
        self.shrink_control(rec)
    }

    /// What is in `v_raw`, rounded to 8 bits and brought to CLIP's size.
    fn shrink_control(&mut self, rec: &mut Recorder) -> Result<(), KernelError> {
        quantize::forward(rec, &self.v_raw, &mut self.marked)?;
        self.resizer.forward(rec, &self.marked, &mut self.control)
    }

    /// The offsets' gradient, from that of the marked frames at CLIP's size and that of the losses that look at pixels.
    pub(super) fn backward(
        &mut self,
        rec: &mut Recorder,
        clip: &TrainingClip,
        v_resized: &Buffer<f32>,
        distortion: Option<Drawn>,
    ) -> Result<(), EngineError> {
        StepPart::Image.record(rec, |rec| self.backward_to_render(rec, v_resized, distortion))?;
        self.backward_from_render(rec, clip)
    }

    /// Gradient of the render, in `v_raw`.
    fn backward_to_render(
        &mut self,
        rec: &mut Recorder,
        v_resized: &Buffer<f32>,
        distortion: Option<Drawn>,
    ) -> Result<(), KernelError> {
        let Self { copies, resizer, raw, marked, v_marked, v_raw, .. } = self;
        let plus = Some(&*v_marked).filter(|v| !v.is_empty());
        match (copies, distortion) {
            (Some(copies), Some(drawn)) => {
                copies.backward(rec, drawn, marked, resizer, v_resized)?;
                let gradient = copies.gradient(rec, plus)?;
                // Without noise its backward pass is that of the clamp to [0, 1].
                let clamp = Noise { sigma: 0.0, seed: 0, stream: 0 };
                noise::backward(rec, &clamp, raw, gradient, v_raw)
            }
            _ => resizer.backward_onward(rec, v_resized, v_raw, Onward { plus, clamped: Some(raw) }),
        }
    }

    /// The offsets' gradient from that of the render.
    fn backward_from_render(&mut self, rec: &mut Recorder, clip: &TrainingClip) -> Result<(), EngineError> {
        let (offsets, gradient) = self.offsets.with_gradient();
        StepPart::RenderBackward.record(rec, |rec| {
            rec.fill(gradient, 0.0);
            self.renderer.backward_clip(rec, &clip.plans, offsets, &self.v_raw, gradient)
        })
    }

    /// What a gradient of 1 at every pixel of a clip makes of the offsets' gradient, between steps.
    pub(super) fn sum_of_pixels(&mut self, rec: &mut Recorder, clip: &TrainingClip) -> Result<(), EngineError> {
        rec.fill(&mut self.v_raw, 1.0);
        self.backward_from_render(rec, clip)
    }
}
