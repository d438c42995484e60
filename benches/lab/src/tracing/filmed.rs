//! Leaks, filmed.

use guard4d_engine::error::EngineError;
use guard4d_engine::media::Frame;
use guard4d_engine::picture::metrics::{Picture, PsnrSummary, SquaredError};
use guard4d_engine::render::SceneRenderer;
use guard4d_engine::scene::gaussians::CHANNELS;
use guard4d_engine::scene::{Camera, Gaussians, Model};
use guard4d_kernels::Device;

use super::film::{Film, shots};

/// How many frames, and how large.
#[derive(Clone, Copy, Debug)]
pub struct Size {
    /// Frames of a film.
    pub frames: u32,
    /// Side of frames, px.
    pub side_px: u32,
}

/// Frames of a leak.
#[derive(Debug)]
pub struct Filmed {
    /// As what.
    pub film: Film,
    /// As they are drawn.
    pub frames: Vec<Frame>,
    /// The camera and time of each.
    pub shots: Vec<(Camera, f32)>,
    /// Against the original.
    pub psnr_db: f64,
}

impl Filmed {
    /// Films splats in place of the model's own.
    ///
    /// # Errors
    /// When the device fails.
    pub fn new(
        device: &Device,
        model: &Model,
        gaussians: &Gaussians,
        film: Film,
        size: Size,
    ) -> Result<Self, EngineError> {
        let shots = shots(model, film.class, size.frames, size.side_px)?;
        let leaked = draw(device, model, gaussians, model.background, &shots)?;
        let clean = draw(device, model, &model.gaussians, model.background, &shots)?;
        let error = |(a, b): (&Frame, &Frame)| SquaredError::between(&Picture::from_frame(a), &Picture::from_frame(b));
        let errors = leaked.iter().zip(&clean).map(error).collect::<Result<Vec<_>, _>>()?;
        let psnr_db = PsnrSummary::of(&errors).map_or(f64::NAN, |psnr| psnr.pooled_db.0);
        Ok(Self { film, frames: leaked, shots, psnr_db })
    }
}

/// Frames of splats that move as a model does.
///
/// # Errors
/// When the device fails.
pub(crate) fn draw(
    device: &Device,
    model: &Model,
    gaussians: &Gaussians,
    background: [f32; CHANNELS],
    shots: &[(Camera, f32)],
) -> Result<Vec<Frame>, EngineError> {
    let mut renderer = SceneRenderer::new(device, gaussians, &model.motion, background)?;
    let mut frames = Vec::new();
    renderer.render_clips(&[shots.to_vec()], |_, camera, pixels| {
        frames.push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
        Ok(())
    })?;
    Ok(frames)
}
