//! How much of what views show comes from each splat, and what follows for its offsets.
//!
//! For one view and time a picture is A·c, so the light that a splat contributes to it is its row of Aᵀ·1: one backward
//! pass with a gradient of 1 at every pixel.

use guard4d_kernels::Device;
use guard4d_kernels::optim::adam::RowRates;

use super::buffers::TrainingBuffers;
use super::offsets::TrainedOffsets;
use super::pool::ClipPool;
use crate::error::EngineError;
use crate::scene::gaussians::{CHANNELS, Y0};

/// Training clips that the visibility is summed over: with a view of its own for each frame, 256 views from all around.
const SUMMED_CLIPS: usize = 32;

/// Visibility of each splat `[N]`: the sum, over all pixels of the first training clips, of the share that it has in
/// their light. Of three colour channels the one counts that lets most through: where a colour is clamped to black, as
/// the offsets are now, an offset shows nothing. Works in buffers that are free between steps.
pub(super) fn measure(
    device: &Device,
    pool: &mut ClipPool,
    buffers: &mut TrainingBuffers,
) -> Result<Vec<f64>, EngineError> {
    let row = buffers.offsets.bases().floats();
    let mut sums = vec![[0.0f64; CHANNELS]; buffers.offsets.num_splats()];
    for index in pool.training().take(SUMMED_CLIPS) {
        let clip = pool.get(index, buffers)?;
        let mut rec = device.recorder()?;
        buffers.sum_of_pixels(&mut rec, &clip)?;
        rec.submit()?;
        for (sum, v) in sums.iter_mut().zip(buffers.offsets.gradient().read()?.chunks_exact(row)) {
            sum.iter_mut().zip(v).for_each(|(sum, v)| *sum += f64::from(*v) / Y0);
        }
    }
    let visibility: Vec<f64> = sums.into_iter().map(|channels| channels.into_iter().fold(0.0, f64::max)).collect();
    match visibility.iter().sum::<f64>() {
        sum if sum.is_finite() => Ok(visibility),
        sum => Err(EngineError::NotFinite { what: "visibility of all splats".to_owned(), got: sum }),
    }
}

/// The splats that together carry a share of all visibility, the fewest that do; those that are never seen are not
/// among them. With a share of 1 it is all splats, seen or not.
#[must_use]
pub fn most_visible(visibility: &[f64], share: f32) -> Vec<bool> {
    if share >= 1.0 {
        return vec![true; visibility.len()];
    }
    let mut order: Vec<usize> = (0..visibility.len()).filter(|i| visibility[*i] > 0.0).collect();
    // Equals in the order of the splats, so that the same inputs give the same bytes.
    order.sort_by(|a, b| visibility[*b].total_cmp(&visibility[*a]));
    let wanted = f64::from(share) * visibility.iter().sum::<f64>();
    let (mut chosen, mut sum) = (vec![false; visibility.len()], 0.0);
    for splat in order {
        if sum >= wanted {
            break;
        }
        chosen[splat] = true;
        sum += visibility[splat];
    }
    chosen
}

/// The rates of all splats' offsets for a share of the visibility: 1 for those that carry it, 0 for the others. `None`
/// where it is 1 everywhere.
pub(super) fn rates(offsets: &TrainedOffsets, visibility: &[f64], share: f32) -> Result<Option<RowRates>, EngineError> {
    if share >= 1.0 {
        return Ok(None);
    }
    let factors: Vec<f32> = most_visible(visibility, share).into_iter().map(|r| f32::from(u8::from(r))).collect();
    Ok(Some(offsets.rates(&factors)?))
}
