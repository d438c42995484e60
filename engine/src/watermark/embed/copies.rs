//! Clips as they look after a distortion, on their way to CLIP and back.

use guard4d_kernels::image::noise::{self, Noise};
use guard4d_kernels::image::quantize;
use guard4d_kernels::image::resize::{self, Onward};
use guard4d_kernels::nn::axpy;
use guard4d_kernels::shape::ClipShape;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

use super::clips::TrainingClip;
use super::config::EmbedConfig;
use super::step::Stage;
use crate::distortion::{Drawn, Layer};
use crate::watermark::extractor::CLIP_FRAMES;

/// Full-size room for one distorted clip.
pub(super) struct Copies {
    layer: Layer,
    /// Before it is rounded.
    raw: Buffer<f32>,
    /// As a video holds it.
    rounded: Buffer<f32>,
}

impl Copies {
    /// Room for the distortions of the settings; `None` where there are none.
    pub(super) fn new(device: &Device, config: &EmbedConfig) -> Result<Option<Self>, KernelError> {
        if config.distortions.is_empty() {
            return Ok(None);
        }
        let size = config.frame_size();
        let clip = ClipShape { frames: CLIP_FRAMES, height: size.height, width: size.width };
        let full = |name: &str| device.buffer(name, clip.pixels() * guard4d_kernels::image::CHANNELS);
        Ok(Some(Self {
            layer: Layer::new(device, clip, &config.distortions)?,
            raw: full("copies.raw")?,
            rounded: full("copies.rounded")?,
        }))
    }
}

impl Stage {
    /// The marked frames, distorted, at CLIP's size in `self.resized`.
    pub(super) fn distort(&mut self, rec: &mut Recorder, drawn: Drawn) -> Result<(), KernelError> {
        let Some(Copies { layer, raw, rounded }) = &mut self.copies else { return Ok(()) };
        layer.forward(rec, drawn, &self.marked, raw)?;
        quantize::forward(rec, raw, rounded)?;
        resize::forward(rec, &self.resize, rounded, &mut self.resized, &mut self.resize_scratch)
    }

    /// The unmarked frames, distorted alike, at CLIP's size in `self.noisy_resized`.
    pub(super) fn distort_control(
        &mut self,
        rec: &mut Recorder,
        clip: &TrainingClip,
        drawn: Drawn,
    ) -> Result<(), KernelError> {
        let Some(Copies { layer, rounded, .. }) = &mut self.copies else { return Ok(()) };
        // `v_raw` is free until the backward pass, `rounded` once the marked frames are resized.
        layer.forward(rec, drawn, &clip.reference, &mut self.v_raw)?;
        quantize::forward(rec, &self.v_raw, rounded)?;
        resize::forward(rec, &self.resize, rounded, &mut self.noisy_resized, &mut self.resize_scratch)
    }

    /// Gradient of the render in `self.v_raw`, from that of the distorted frames at CLIP's size and that of the losses that
    /// look at plain pixels.
    pub(super) fn undistort(
        &mut self,
        rec: &mut Recorder,
        drawn: Drawn,
        v_resized: &Buffer<f32>,
    ) -> Result<(), KernelError> {
        let Some(Copies { layer, raw, rounded }) = &mut self.copies else { return Ok(()) };
        let onward = Onward { plus: None, clamped: Some(raw) };
        resize::backward(rec, &self.resize, v_resized, (&mut *rounded, onward), &mut self.resize_scratch)?;
        layer.backward(rec, drawn, (&self.marked, rounded), raw)?;
        let v_marked = if self.v_marked.is_empty() {
            &*raw
        } else {
            axpy::forward(rec, 1.0, raw, &self.v_marked, rounded)?;
            &*rounded
        };
        // Without noise its backward pass is that of the clamp to [0, 1].
        let clamp = Noise { sigma: 0.0, seed: 0, stream: 0 };
        noise::backward(rec, &clamp, &self.raw, v_marked, &mut self.v_raw)
    }
}
