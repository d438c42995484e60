//! Distortions of finished clips, one after the other: what a verifier may be given instead of the original.

use guard4d_kernels::image::quantize;
use guard4d_kernels::shape::ClipShape;
use guard4d_kernels::{Buffer, Device};

use super::kind::Distortion;
use super::layer::{DistortionLayer, Drawn};
use crate::error::EngineError;
use crate::media::Frame;

/// Distortions one after the other, each rounded to 8 bits, of frames of one size.
#[derive(Debug)]
pub struct DistortionChain {
    device: Device,
    size_px: (u32, u32),
    layer: DistortionLayer,
    frame: Buffer<f32>,
    distorted: Buffer<f32>,
    seed: u64,
}

impl DistortionChain {
    /// Prepares a chain for frames of `size_px` (width, height).
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a distortion with a range of strengths; when memory runs out.
    pub fn new(device: &Device, size_px: (u32, u32), chain: &[Distortion], seed: u64) -> Result<Self, EngineError> {
        if let Some(range) = chain.iter().find(|d| !d.is_fixed()) {
            return Err(EngineError::Usage {
                what: "distortion of a finished clip".to_owned(),
                got: range.to_string(),
                expected: "one strength".to_owned(),
            });
        }
        let clip = ClipShape { frames: 1, height: size_px.1 as usize, width: size_px.0 as usize };
        let floats = clip.pixels() * guard4d_kernels::image::CHANNELS;
        Ok(Self {
            device: device.clone(),
            size_px,
            layer: DistortionLayer::new(device, clip, chain)?,
            frame: device.buffer("distortion.frame", floats)?,
            distorted: device.buffer("distortion.distorted", floats)?,
            seed,
        })
    }

    /// One frame of a clip, distorted; frames of other numbers get other noise.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a frame of another size; when the device fails.
    pub fn apply(&mut self, frame: &Frame, number: u32) -> Result<Frame, EngineError> {
        let (width, height) = self.size_px;
        if (frame.width(), frame.height()) != self.size_px {
            return Err(EngineError::Usage {
                what: format!("size of frame {number}"),
                got: format!("{} x {} px", frame.width(), frame.height()),
                expected: format!("{width} x {height} px"),
            });
        }
        self.frame.write(&frame.to_rgba32f())?;
        let mut rec = self.device.recorder()?;
        for index in 0..self.layer.len() {
            let drawn = Drawn { index, share: 0.0, seed: self.seed.wrapping_add(index as u64), stream: number };
            self.layer.forward(&mut rec, drawn, &self.frame, &mut self.distorted)?;
            quantize::forward(&mut rec, &self.distorted, &mut self.frame)?;
        }
        rec.submit()?;
        Frame::from_rgba32f(width, height, &self.frame.read()?)
    }
}
