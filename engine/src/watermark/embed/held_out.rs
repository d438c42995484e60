//! What a mark is worth on clips that no step is taken on.

use guard4d_kernels::Device;

use super::buffers::TrainingBuffers;
use super::config::EmbedConfig;
use super::extractor_loss::{ClipReading, ExtractorLoss};
use super::pool::ClipPool;
use super::report::HeldOutReport;
use super::scores::{column_means, share_proven, share_right};
use crate::error::EngineError;

/// Fidelity and readability of the mark on the held-out clips.
pub(super) fn evaluate(
    device: &Device,
    loss: &mut ExtractorLoss,
    buffers: &mut TrainingBuffers,
    pool: &mut ClipPool,
    config: &EmbedConfig,
) -> Result<HeldOutReport, EngineError> {
    let (mut squares, mut marked, mut unmarked, mut len) = (0.0, Vec::new(), Vec::new(), 1);
    let clips = pool.held_out();
    for index in clips.clone() {
        let clip = loss.clip(pool, buffers, index)?;
        loss.foretell(device, buffers, index, &clip)?;
        let reading: ClipReading = loss.read_clip(device, buffers, &clip, config)?;
        squares += reading.mse;
        len = reading.marked.len();
        marked.extend(reading.marked);
        unmarked.extend(reading.unmarked);
    }
    let message = *loss.message();
    let psnr = -10.0 * (squares / clips.len() as f32).log10();
    let zero = column_means(&unmarked, message.num_bits() as usize);
    let bit_accuracy = share_right(&marked, &zero, &message);
    let readings: Vec<f32> = marked.chunks_exact(len).flat_map(|clip| column_means(clip, zero.len())).collect();
    let clip_accuracy = share_right(&readings, &zero, &message);
    let sum: f32 = marked.iter().chain(&unmarked).sum();
    if psnr.is_nan() || !sum.is_finite() {
        return Err(EngineError::NotFinite { what: "held-out figures".to_owned(), got: f64::from(psnr + sum) });
    }
    let proven = share_proven(&readings, &zero, &message, config.proof(zero.len()))?;
    Ok(HeldOutReport { bit_accuracy, clip_accuracy, proven, psnr })
}
