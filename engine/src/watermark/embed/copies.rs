//! Clips as they look after a distortion, on their way to CLIP and back.

use guard4d_kernels::image::quantize;
use guard4d_kernels::image::resize::Onward;
use guard4d_kernels::nn::axpy;
use guard4d_kernels::shape::ClipShape;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::config::EmbedConfig;
use crate::picture::distortion::{DistortionLayer, Drawn, Resizer};
use crate::watermark::extractor::weights::CLIP_FRAMES;

/// Full-size room for one distorted clip.
pub(super) struct Copies {
    layer: DistortionLayer,
    /// Before it is rounded; the way back asks for it.
    raw: Buffer<f32>,
    /// As a video holds it; free once it is resized.
    rounded: Buffer<f32>,
}

impl Copies {
    /// Room for the distortions of the settings; `None` where there are none.
    pub(super) fn new(device: &Device, config: &EmbedConfig) -> Result<Option<Self>, KernelError> {
        let distortions = &config.objective.distortions;
        if distortions.is_empty() {
            return Ok(None);
        }
        let size = config.views.frame_size();
        let clip = ClipShape { frames: CLIP_FRAMES, height: size.height, width: size.width };
        let full = |name: &str| device.buffer(name, clip.pixels() * guard4d_kernels::image::CHANNELS);
        Ok(Some(Self {
            layer: DistortionLayer::new(device, clip, distortions)?,
            raw: full("copies.raw")?,
            rounded: full("copies.rounded")?,
        }))
    }

    /// Distorted frames at CLIP's size, and what the way back needs of them.
    pub(super) fn forward(
        &mut self,
        rec: &mut Recorder,
        drawn: Drawn,
        frames: &Buffer<f32>,
        resizer: &mut Resizer,
        resized: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        self.layer.forward(rec, drawn, frames, &mut self.raw)?;
        quantize::forward(rec, &self.raw, &mut self.rounded)?;
        resizer.forward(rec, &self.rounded, resized)
    }

    /// Frames distorted into `distorted`, with no way back; [`Copies::shrink`] brings them to CLIP's size. What
    /// [`Copies::forward`] left for its own way back stays.
    pub(super) fn distort(
        &mut self,
        rec: &mut Recorder,
        drawn: Drawn,
        frames: &Buffer<f32>,
        distorted: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        self.layer.forward(rec, drawn, frames, distorted)
    }

    /// Distorted frames at CLIP's size.
    pub(super) fn shrink(
        &mut self,
        rec: &mut Recorder,
        distorted: &Buffer<f32>,
        resizer: &mut Resizer,
        resized: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        quantize::forward(rec, distorted, &mut self.rounded)?;
        resizer.forward(rec, &self.rounded, resized)
    }

    /// Gradient of the `frames` of [`Copies::forward`], from that of the distorted ones at CLIP's size.
    pub(super) fn backward(
        &mut self,
        rec: &mut Recorder,
        drawn: Drawn,
        frames: &Buffer<f32>,
        resizer: &mut Resizer,
        v_resized: &Buffer<f32>,
    ) -> Result<(), KernelError> {
        let onward = Onward { plus: None, clamped: Some(&self.raw) };
        resizer.backward_onward(rec, v_resized, &mut self.rounded, onward)?;
        self.layer.backward(rec, drawn, frames, &self.rounded, &mut self.raw)
    }

    /// That gradient, with another one added if there is one.
    pub(super) fn gradient(
        &mut self,
        rec: &mut Recorder,
        plus: Option<&Buffer<f32>>,
    ) -> Result<&Buffer<f32>, KernelError> {
        let Some(plus) = plus else { return Ok(&self.raw) };
        axpy::forward(rec, 1.0, &self.raw, plus, &mut self.rounded)?;
        Ok(&self.rounded)
    }
}
