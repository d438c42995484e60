//! Deformation and rendering of whole scenes, end to end.

mod deform;
mod profile;
mod renderer;
mod scene_renderer;
mod settings;
mod storage;

use guard4d_engine::error::EngineError;
use guard4d_engine::render::{FrameMut, FramePlan, Offsets, Renderer};
use guard4d_kernels::Device;

/// The constant spherical harmonic, sqrt(1 / 4π).
const Y_0: f32 = 0.282_094_8;

/// One frame `[H,W,4]`.
fn image(
    device: &Device,
    renderer: &mut Renderer,
    plan: &FramePlan,
    offsets: Option<Offsets<'_>>,
    background: [f32; 3],
) -> Result<Vec<f32>, EngineError> {
    let mut clip = device.buffer("image", plan.frame_len())?;
    let mut rec = device.recorder()?;
    renderer.forward(&mut rec, plan, offsets, background, FrameMut { clip: &mut clip, index: 0 })?;
    rec.submit()?;
    Ok(clip.read()?)
}

/// Peak signal-to-noise ratio of the colours, in dB.
fn psnr(a: &[f32], b: &[f32]) -> f64 {
    let errors = a.chunks(4).zip(b.chunks(4)).flat_map(|(x, y)| (0..3).map(|k| f64::from(x[k] - y[k]).powi(2)));
    let mean = errors.sum::<f64>() / (a.len() as f64 * 0.75);
    -10.0 * mean.log10()
}
