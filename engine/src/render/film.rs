//! Rendering of whole camera sets, frame by frame.

use guard4d_kernels::Device;

use super::{FrameMut, Offsets, Prune, Renderer};
use crate::deform::DeformField;
use crate::error::EngineError;
use crate::scene::{CameraSet, DeformationWeights, Gaussians};

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
        deformation: Option<&DeformationWeights>,
        background: [f32; 3],
    ) -> Result<Self, EngineError> {
        let field = DeformField::new(device, gaussians, deformation)?;
        Ok(Self { device: device.clone(), field, renderer: Renderer::new(device)?, background })
    }

    /// Renders every (view, time) in order and hands each frame on: view, index of its time, pixels
    /// `[H,W,4]` (rgb not clamped, then the final transmittance).
    ///
    /// # Errors
    /// When the device fails, or `each` does.
    pub fn shoot(
        &mut self,
        cameras: &CameraSet,
        offsets: Option<Offsets<'_>>,
        mut each: impl FnMut(usize, usize, &[f32]) -> Result<(), EngineError>,
    ) -> Result<(), EngineError> {
        for (v, view) in cameras.views.iter().enumerate() {
            for (t, &time) in view.times.iter().enumerate() {
                let state = self.field.at(time)?;
                let plan = self.renderer.plan(&state, &view.camera, Prune::Keep)?;
                let mut clip = self.device.buffer("film.frame", plan.frame_len())?;
                let mut rec = self.device.recorder()?;
                let frame = FrameMut { clip: &mut clip, index: 0 };
                self.renderer.forward(&mut rec, &plan, offsets, self.background, frame)?;
                rec.submit()?;
                each(v, t, &clip.read()?)?;
            }
        }
        Ok(())
    }
}
