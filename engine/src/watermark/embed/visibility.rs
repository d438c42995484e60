//! How much of what views show comes from each splat, and what follows for its offsets.
//!
//! For one view and time a picture is A·c, so the light that a splat contributes to it is its row of Aᵀ·1: one backward
//! pass with a gradient of 1 at every pixel.

use guard4d_kernels::Device;
use guard4d_kernels::optim::adam::RowRates;

use super::pool::ClipPool;
use super::step::Stage;
use crate::error::EngineError;
use crate::render::Offsets;
use crate::scene::gaussians::{CHANNELS, Y0};

/// Training clips that the light is summed over: with a view of its own for each frame, 256 views from all around.
const LIT_CLIPS: usize = 32;

/// Visible weight of each splat `[N]`: the sum, over all pixels of the first training clips, of the share that it has in
/// their light. Of three colour channels the one counts that lets most through: where a colour is clamped to black, as the
/// offsets are now, an offset shows nothing. Works in buffers of the stage that are free between steps.
pub(super) fn weights(device: &Device, pool: &mut ClipPool, stage: &mut Stage) -> Result<Vec<f64>, EngineError> {
    let row = stage.bases.floats();
    let mut sums = vec![[0.0f64; CHANNELS]; stage.num_splats];
    for index in pool.training().take(LIT_CLIPS) {
        let clip = pool.get(index, stage)?;
        let mut rec = device.recorder()?;
        rec.fill(&mut stage.v_raw, 1.0);
        rec.fill(&mut stage.v_offsets, 0.0);
        let offsets = Offsets { data: &stage.offsets, bases: stage.bases };
        stage.renderer.backward_clip(&mut rec, &clip.plans, offsets, &stage.v_raw, &mut stage.v_offsets)?;
        rec.submit()?;
        for (sum, v) in sums.iter_mut().zip(stage.v_offsets.read()?.chunks_exact(row)) {
            sum.iter_mut().zip(v).for_each(|(sum, v)| *sum += f64::from(*v) / Y0);
        }
    }
    let weights: Vec<f64> = sums.into_iter().map(|channels| channels.into_iter().fold(0.0, f64::max)).collect();
    match weights.iter().sum::<f64>() {
        sum if sum.is_finite() => Ok(weights),
        sum => Err(EngineError::NotFinite { what: "visible weight of all splats".to_owned(), got: sum }),
    }
}

/// The splats that together carry a share `reach` of all visible weight, the fewest that do; those that are never seen
/// are not among them. With a share of 1 it is all splats, seen or not.
#[must_use]
pub fn within_reach(weights: &[f64], reach: f32) -> Vec<bool> {
    if reach >= 1.0 {
        return vec![true; weights.len()];
    }
    let mut order: Vec<usize> = (0..weights.len()).filter(|i| weights[*i] > 0.0).collect();
    // Equal weights in the order of the splats, so that the same inputs give the same bytes.
    order.sort_by(|a, b| weights[*b].total_cmp(&weights[*a]));
    let wanted = f64::from(reach) * weights.iter().sum::<f64>();
    let (mut reached, mut sum) = (vec![false; weights.len()], 0.0);
    for splat in order {
        if sum >= wanted {
            break;
        }
        reached[splat] = true;
        sum += weights[splat];
    }
    reached
}

/// The rates of all splats' offsets by the settings, for [`guard4d_kernels::optim::adam::AdamState`]: 0 beyond the reach, 1
/// within it. `None` where it is 1 everywhere.
pub(super) fn rates(
    device: &Device,
    (weights, stage): (&[f64], &Stage),
    reach: f32,
) -> Result<Option<RowRates>, EngineError> {
    if reach >= 1.0 {
        return Ok(None);
    }
    let factors: Vec<f32> = within_reach(weights, reach).into_iter().map(|r| f32::from(u8::from(r))).collect();
    Ok(Some(RowRates { row: stage.bases.floats(), factors: device.buffer_from("visibility.rates", &factors)? }))
}
