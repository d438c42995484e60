//! Resizing of clips, with its working memory.

use guard4d_kernels::image::resize::{self, Onward, ResizePlan};
use guard4d_kernels::{Buffer, Device, KernelError, Recorder};

/// A resize or blur with its working memory.
#[derive(Debug)]
pub(crate) struct Resizer {
    plan: ResizePlan,
    scratch: Buffer<f32>,
}

impl Resizer {
    /// Room for clips of `frames` frames.
    ///
    /// # Errors
    /// When memory runs out.
    pub(crate) fn new(device: &Device, frames: usize, plan: ResizePlan) -> Result<Self, KernelError> {
        Ok(Self { scratch: plan.scratch(device, frames)?, plan })
    }

    /// Goes on with another plan between the same sizes.
    pub(crate) fn replace(&mut self, plan: ResizePlan) {
        self.plan = plan;
    }

    /// Resizes a clip.
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub(crate) fn forward(
        &mut self,
        rec: &mut Recorder,
        x: &Buffer<f32>,
        y: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        resize::forward(rec, &self.plan, x, y, &mut self.scratch)
    }

    /// Gradient to the clip that was resized.
    ///
    /// # Errors
    /// [`KernelError::Shape`] before anything is recorded.
    pub(crate) fn backward(
        &mut self,
        rec: &mut Recorder,
        v_y: &Buffer<f32>,
        v_x: &mut Buffer<f32>,
    ) -> Result<(), KernelError> {
        self.backward_onward(rec, v_y, v_x, Onward::default())
    }

    /// The same, and what its last pass does besides.
    ///
    /// # Errors
    /// As [`Resizer::backward`].
    pub(crate) fn backward_onward(
        &mut self,
        rec: &mut Recorder,
        v_y: &Buffer<f32>,
        v_x: &mut Buffer<f32>,
        onward: Onward<'_>,
    ) -> Result<(), KernelError> {
        resize::backward(rec, &self.plan, v_y, v_x, onward, &mut self.scratch)
    }
}
