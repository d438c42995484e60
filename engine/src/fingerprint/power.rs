//! What a copy would score in a film that nothing was done to: how much could have been found.

use guard4d_kernels::Device;

use super::fidelity::{TRIAL_COPY, pictures};
use super::film::{Gatherer, Shot};
use super::issue::Issue;
use crate::error::EngineError;
use crate::media::Frame;
use crate::scene::Camera;

/// Frames that stand for all of a film.
const SAMPLES: usize = 6;

/// The score, in the unit of [`Code::score`](super::code::Code::score), of a copy that is filmed from `shots` to 8 bits:
/// measured on a few of them with a copy that nobody has.
///
/// # Errors
/// When memory runs out or the device fails.
pub fn unspoilt_score(device: &Device, issue: &Issue<'_>, shots: &[(Camera, f32)]) -> Result<f64, EngineError> {
    let sampled: Vec<(Camera, f32)> = shots.iter().step_by(shots.len().div_ceil(SAMPLES).max(1)).copied().collect();
    let filmed = pictures(device, issue.model(), &issue.stamp(TRIAL_COPY), &sampled)?;
    let mut gatherer = Gatherer::new(device, issue.model())?;
    for (pixels, &(camera, time)) in filmed.iter().zip(&sampled) {
        let frame = Frame::from_rgba32f(camera.width, camera.height, pixels)?;
        gatherer.add(&Shot { frame: &frame, camera, time })?;
    }
    let evidence = issue.evidence(&gatherer.into_evidence())?;
    let score = issue.code().score(&evidence, &issue.copy_key(TRIAL_COPY))?;
    Ok(score * shots.len() as f64 / sampled.len().max(1) as f64)
}
