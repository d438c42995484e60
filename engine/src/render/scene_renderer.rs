//! Whole camera sets, each frame rendered once: what is looked at, measured and verified.

use guard4d_kernels::Device;
use guard4d_kernels::splat::rasterize::FrameMut;
use guard4d_kernels::splat::tile_bin::Prune;

use super::profile::Profile;
use super::renderer::Renderer;
use crate::error::EngineError;
use crate::media::Frame;
use crate::render::deform::DeformField;
use crate::scene::{Camera, CameraSet, Gaussians, Model, Motion};

/// A scene that is rendered from many cameras once each.
#[derive(Debug)]
pub struct SceneRenderer {
    device: Device,
    field: DeformField,
    renderer: Renderer,
    background: [f32; 3],
}

impl SceneRenderer {
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
        Self::of_field(device, DeformField::new(device, gaussians, motion)?, background)
    }

    /// Uploads a scene that is shown as another renderer shows it.
    ///
    /// # Errors
    /// When device memory runs out.
    pub fn by_profile(
        device: &Device,
        gaussians: &Gaussians,
        motion: &Motion,
        background: [f32; 3],
        profile: &Profile,
    ) -> Result<Self, EngineError> {
        let scene = Self::of_field(device, profile.upload(device, gaussians, motion)?, background)?;
        Ok(Self { renderer: scene.renderer.with_rules(profile.rules), ..scene })
    }

    /// Of a scene that is uploaded.
    ///
    /// # Errors
    /// When device memory runs out.
    pub fn of_field(device: &Device, field: DeformField, background: [f32; 3]) -> Result<Self, EngineError> {
        Ok(Self { device: device.clone(), field, renderer: Renderer::new(device)?, background })
    }

    /// Keeps fewer moments of the scene from now on; whether that can be.
    pub fn save_memory(&mut self) -> bool {
        self.field.save_memory()
    }

    /// The scene, with the moments that were rendered last.
    #[must_use]
    pub fn into_field(self) -> DeformField {
        self.field
    }

    /// Renders every frame of every clip in order and hands it on: number of the clip, camera, pixels
    /// `[H,W,4]` (rgb not clamped, then the final transmittance).
    ///
    /// # Errors
    /// When the device fails, or `each` does.
    pub fn render_clips(
        &mut self,
        clips: &[Vec<(Camera, f32)>],
        mut each: impl FnMut(usize, &Camera, &[f32]) -> Result<(), EngineError>,
    ) -> Result<(), EngineError> {
        for (number, clip) in clips.iter().enumerate() {
            for (camera, time) in clip {
                let state = self.field.at(*time)?;
                let plan = self.renderer.plan(&state, camera, Prune::Keep)?;
                let mut pixels = self.device.buffer("scene_renderer.frame", plan.frame_len())?;
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

/// 8-bit frames of a model, one list per clip of `cameras`, see [`CameraSet::clips`].
///
/// # Errors
/// When the device fails.
pub fn render_frames(device: &Device, model: &Model, cameras: &CameraSet) -> Result<Vec<Vec<Frame>>, EngineError> {
    let clips = cameras.clips();
    let mut frames = vec![Vec::new(); clips.len()];
    let mut renderer = SceneRenderer::new(device, &model.gaussians, &model.motion, model.background)?;
    renderer.render_clips(&clips, |number, camera, pixels| {
        frames[number].push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
        Ok(())
    })?;
    Ok(frames)
}
