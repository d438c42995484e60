//! Rendering of whole camera sets, frame by frame.

use guard4d_kernels::Device;

use super::{FrameMut, Prune, Renderer};
use crate::deform::DeformField;
use crate::error::EngineError;
use crate::scene::{Camera, Gaussians, Motion};

/// A scene that is rendered from many cameras once each.
#[derive(Debug)]
pub struct Film {
    device: Device,
    field: DeformField,
    renderer: Renderer,
    background: [f32; 3],
}

impl Film {
    /// Uploads a scene.
    ///
    /// # Errors
    /// When device memory runs out.
    pub fn new(
        device: &Device,
        gaussians: &Gaussians,
        motion: &Motion,
        background: [f32; 3],
    ) -> Result<Self, EngineError> {
        let field = DeformField::new(device, gaussians, motion)?;
        Ok(Self { device: device.clone(), field, renderer: Renderer::new(device)?, background })
    }

    /// Renders every frame of every clip in order and hands it on: number of the clip, camera, pixels
    /// `[H,W,4]` (rgb not clamped, then the final transmittance).
    ///
    /// # Errors
    /// When the device fails, or `each` does.
    pub fn shoot(
        &mut self,
        clips: &[Vec<(Camera, f32)>],
        mut each: impl FnMut(usize, &Camera, &[f32]) -> Result<(), EngineError>,
    ) -> Result<(), EngineError> {
        for (number, clip) in clips.iter().enumerate() {
            for (camera, time) in clip {
                let state = self.field.at(*time)?;
                let plan = self.renderer.plan(&state, camera, Prune::Keep)?;
                let mut pixels = self.device.buffer("film.frame", plan.frame_len())?;
                let mut rec = self.device.recorder()?;
                let frame = FrameMut { clip: &mut pixels, index: 0 };
                self.renderer.forward(&mut rec, &plan, None, self.background, frame)?;
                rec.submit()?;
                each(number, camera, &pixels.read()?)?;
            }
        }
        Ok(())
    }
}
