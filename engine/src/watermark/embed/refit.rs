//! Fitting an extractor to its asset once more, to see whether another one is what the fitting gives.

use super::buffers::TrainingBuffers;
use super::config::EmbedConfig;
use super::fit::{self, Fitted};
use super::fit_context::FitContext;
use super::pool::ClipPool;
use super::subject::Subject;
use crate::error::EngineError;
use crate::watermark::extractor::rotation::KeyRotation;
use crate::watermark::extractor::weights::ExtractorWeights;

/// The extractor that an embedding with these settings began with, turned by this rotation of the key. Those of
/// `joint` were trained from there on.
///
/// # Errors
/// Those of [`super::Embedding::prepare`].
pub fn refit(
    subject: Subject<'_>,
    config: &EmbedConfig,
    key_rotation: KeyRotation,
) -> Result<ExtractorWeights, EngineError> {
    let Subject { device, clip, key, model, .. } = subject;
    // What is kept of clips for losses alone takes time and memory, and fits nothing.
    let config = config.clone().with(|config| config.objective.lpips = None).for_degree(model.gaussians.sh_degree);
    config.validate_for(key.bits())?;
    let prf = key.prf();
    let mut pool = ClipPool::draw(device, model, &prf, &config)?;
    let mut buffers = TrainingBuffers::new(device, model, &config.in_phase(0), clip.config().vision_config.image_size)?;
    pool.fill(&mut buffers)?;
    let mut context = FitContext { device, config: &config, prf: &prf, pool: &mut pool, buffers: &mut buffers };
    let Fitted { mut weights, unmarked, .. } = fit::extractor(&mut context, clip, key)?;
    if key_rotation != KeyRotation::FIXED {
        let (mut from, mut to) = (KeyRotation::FIXED.stream(&prf), key_rotation.stream(&prf));
        weights.calibration = weights.calibration.mixed_anew(&mut from, &mut to);
        pool.with_room(|| fit::set_zero(device, key, &mut weights.calibration, &unmarked))?;
        weights.key_rotation = key_rotation;
    }
    Ok(weights)
}
