//! Mean squared and mean absolute difference of colours, in one pass.

use super::sum::{PARTIALS_PER_GROUP, PER_INVOCATION, SumScratch, VALUES, finish};
use super::term::{PixelPair, Term};
use crate::error::KernelError;
use crate::registry::loss::pixel_step;
use crate::shape::dim;
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "loss/pixel";

/// Weights of both losses in the gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelWeights {
    /// On the mean square.
    pub square: f32,
    /// On the mean absolute difference.
    pub absolute: f32,
}

/// Values over three colour channels and, where it is wanted, their gradient; the fourth channel is not read.
///
/// # Shapes
/// in `pair`: `image` \[.,4\] and `reference` \[.,4\], n pixels of each ·
/// out `v_image`, if given, like `image`, those pixels (=) or (+=), fourth channel 0 · `term.values`, [`VALUES`]
/// elements (=); `term.weight` is a factor on both weights
/// # Equation: Σ (x − y)² / 3n and Σ |x − y| / 3n; the derivative of the latter at equality is 0
/// # Determinism: bitwise; sums in a fixed order, no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn step(
    rec: &mut Recorder,
    pair: &PixelPair<'_>,
    weights: PixelWeights,
    v_image: Option<&mut Buffer<f32>>,
    term: Term<'_>,
    scratch: &mut SumScratch,
) -> Result<(), KernelError> {
    pair.check(KERNEL, v_image.as_deref())?;
    term.slots(KERNEL, VALUES)?;
    let groups = scratch.groups(KERNEL, pair.num_px)?;
    let mean = 1.0 / (pair.num_px.max(1) as f32 * 3.0);
    let params = pixel_step::Params {
        n: dim(pair.num_px),
        image_px: dim(pair.image_px),
        reference_px: dim(pair.reference_px),
        square_scale: term.weight * weights.square * mean,
        absolute_scale: term.weight * weights.absolute * mean,
    };
    let gradient = u32::from(v_image.is_some());
    let spec = pixel_step::Spec { accumulate: term.accumulate.flag(), pixels: PER_INVOCATION, gradient };
    // Without a gradient the binding needs a buffer that is nobody else's; it is not touched.
    let v_image = v_image.unwrap_or(&mut *term.values);
    let before = v_image.alias();
    let bind = pixel_step::Bind {
        image: pair.image,
        reference: pair.reference,
        v_before: &before,
        v_image,
        partial: &mut scratch.partial,
    };
    rec.dispatch_spec(bind, params, spec, Grid::groups(dim(groups), 1, 1))?;
    let partials = groups * PARTIALS_PER_GROUP;
    for value in 0..VALUES {
        let range = value * partials..(value + 1) * partials;
        finish(rec, &scratch.partial, range, mean, &mut *term.values, term.slot + value)?;
    }
    Ok(())
}
