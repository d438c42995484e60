//! Mean squared difference of colours.

use crate::loss::sum::{PARTIALS_PER_GROUP, PER_INVOCATION, SumScratch, finish};
use crate::loss::{PixelPair, Term};
use crate::registry::loss::mse_step;
use crate::shape::dim;
use crate::{Buffer, Grid, KernelError, Recorder};

const KERNEL: &str = "loss/mse";

/// Value and gradient over three colour channels; the fourth channel is not read.
///
/// # Shapes
/// in `pair`: `image` [.,4] and `reference` [.,4], n pixels of each ·
/// out `v_image` like `image`, those pixels (=) or (+=), fourth channel 0 · `term.values`, one element (=)
/// # Equation: Σ (x − y)² / 3n
/// # Determinism: bitwise; sums in a fixed order, no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn step(
    rec: &mut Recorder,
    pair: &PixelPair<'_>,
    v_image: &mut Buffer<f32>,
    term: Term<'_>,
    scratch: &mut SumScratch,
) -> Result<(), KernelError> {
    pair.check(KERNEL, v_image)?;
    term.slot(KERNEL)?;
    let groups = scratch.groups(KERNEL, pair.num_px)?;
    let mean = 1.0 / (pair.num_px.max(1) as f32 * 3.0);
    let params = mse_step::Params {
        n: dim(pair.num_px),
        image_px: dim(pair.image_px),
        reference_px: dim(pair.reference_px),
        slope_scale: term.weight * mean,
    };
    let spec = mse_step::Spec { accumulate: term.accumulate.flag(), pixels: PER_INVOCATION };
    let before = v_image.alias();
    let bind = mse_step::Bind {
        image: pair.image,
        reference: pair.reference,
        v_before: &before,
        v_image,
        partial: &mut scratch.partial,
    };
    rec.dispatch_spec(bind, params, spec, Grid::groups(dim(groups), 1, 1))?;
    finish(rec, (&scratch.partial, groups * PARTIALS_PER_GROUP), mean, (term.values, term.slot))
}
