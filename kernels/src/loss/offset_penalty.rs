//! Penalty on SH offsets.

use crate::loss::Term;
use crate::loss::sum::{PARTIALS_PER_GROUP, PER_INVOCATION, SumScratch, finish};
use crate::registry::loss::offset_penalty_step;
use crate::shape::{dim, expect_len};
use crate::{Buffer, Grid, KernelError, Recorder};

const KERNEL: &str = "loss/offset_penalty";
/// Offsets of one splat: 16 coefficients of 3 channels.
const PER_SPLAT: usize = 48;

/// Weights of the two means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockWeights {
    /// On the mean over DC offsets.
    pub dc: f32,
    /// On the mean over all others.
    pub rest: f32,
}

/// Value and gradient.
///
/// # Shapes
/// in `offsets` [N,16,3] · out `v_offsets` [N,16,3] (=) or (+=) · `term.values`, one element (=)
/// # Equation: dc · mean(Δ_dc²) + rest · mean(Δ_rest²); with weights 1 the L_off of Guard4D as means
/// # Determinism: bitwise; sums in a fixed order, no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn step(
    rec: &mut Recorder,
    (offsets, blocks): (&Buffer<f32>, BlockWeights),
    v_offsets: &mut Buffer<f32>,
    term: Term<'_>,
    scratch: &mut SumScratch,
) -> Result<(), KernelError> {
    let splats = offsets.len() / PER_SPLAT;
    expect_len(KERNEL, "offsets", offsets, splats * PER_SPLAT)?;
    expect_len(KERNEL, "v_offsets", v_offsets, offsets.len())?;
    term.slot(KERNEL)?;
    let texels = offsets.len() / 4;
    let groups = scratch.groups(KERNEL, texels)?;
    let per_channel = splats.max(1) as f32 * 3.0;
    let params = offset_penalty_step::Params {
        n: dim(texels),
        dc: blocks.dc / per_channel,
        rest: blocks.rest / (per_channel * 15.0),
        weight: term.weight,
    };
    let spec = offset_penalty_step::Spec { accumulate: term.accumulate.flag(), texels: PER_INVOCATION };
    let before = v_offsets.alias();
    let bind = offset_penalty_step::Bind { offsets, v_before: &before, v_offsets, partial: &mut scratch.partial };
    rec.dispatch_spec(bind, params, spec, Grid::groups(dim(groups), 1, 1))?;
    finish(rec, (&scratch.partial, groups * PARTIALS_PER_GROUP), 1.0, (term.values, term.slot))
}
