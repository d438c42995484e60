//! What renderers go by that sort by buckets of depth: the order in which they keep splats, and the box of all.

use guard4d_kernels::Device;
use guard4d_kernels::splat::project::Buckets;

use crate::error::EngineError;

/// Steps of a place along each axis.
const STEPS: f32 = 1024.0;
/// How far a splat reaches, in its largest standard deviations.
const REACH: f32 = 2.0;

/// Of splats whose means and log scales these are.
///
/// # Equation
/// The `PlayCanvas` engine 2.23.3, `scene/gsplat/gsplat-data.js`: splats of a PLY are kept along a Morton curve through
/// 1024 steps of each axis, those of one step in the order of the file (`calcMortonOrder`); the box reaches two of each
/// splat's largest deviations beyond its mean (`calcAabb`).
pub(super) fn buckets_of(device: &Device, means: &[[f32; 3]], scales: &[[f32; 3]]) -> Result<Buckets, EngineError> {
    let reaches = scales.iter().map(|[x, y, z]| REACH * x.max(*y).max(*z).exp());
    let (mut inner, mut outer) = (Box::EMPTY, Box::EMPTY);
    for (place, reach) in means.iter().zip(reaches) {
        inner.take(*place, 0.0);
        if reach.is_finite() {
            outer.take(*place, reach);
        }
    }
    let mut along: Vec<u32> = (0u32..).zip(means).map(|(row, _)| row).collect();
    along.sort_by_cached_key(|row| morton(&inner, means[*row as usize]));
    Ok(Buckets { along: device.buffer_from("scene.along", &along)?, corners: [outer.low, outer.high] })
}

/// From the lowest to the highest coordinates.
#[derive(Clone, Copy, Debug)]
struct Box {
    low: [f32; 3],
    high: [f32; 3],
}

impl Box {
    const EMPTY: Self = Self { low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3] };

    /// Takes in what reaches so far beyond a place, if that is one.
    fn take(&mut self, place: [f32; 3], reach: f32) {
        if place.iter().all(|at| at.is_finite()) {
            self.low.iter_mut().zip(place).for_each(|(low, at)| *low = low.min(at - reach));
            self.high.iter_mut().zip(place).for_each(|(high, at)| *high = high.max(at + reach));
        }
    }
}

/// Place along the curve: the bits of all steps, those of z first.
fn morton(within: &Box, place: [f32; 3]) -> u32 {
    let mut code = 0;
    let axes = place.into_iter().zip(within.low).zip(within.high).enumerate();
    for (axis, ((at, low), high)) in axes {
        let extent = high - low;
        let step = if extent > 0.0 { (at - low) * (STEPS / extent) } else { 0.0 };
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "what is no place is the first")]
        let step = step.floor().clamp(0.0, STEPS - 1.0) as u32;
        code |= (0..10).map(|bit| (step >> bit & 1) << (3 * bit + axis)).sum::<u32>();
    }
    code
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_goes_by_the_bits_of_all_steps() {
        let within = Box { low: [0.0; 3], high: [1024.0, 1024.0, 2048.0] };
        let codes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0], [2.0, 0.0, 0.0], [1024.0; 3]]
            .map(|place| morton(&within, place));
        assert_eq!(codes, [1, 2, 4, 8, 997_045_979]);
        assert_eq!(morton(&within, [f32::NAN, -3.0, 0.0]), 0, "what is no place is the first");
    }
}
