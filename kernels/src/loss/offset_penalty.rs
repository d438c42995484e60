//! Penalty on SH offsets.

use super::sum::{LANES, PARTIALS_PER_GROUP, PER_INVOCATION, SumScratch, finish};
use super::term::Term;
use crate::error::KernelError;
use crate::registry::loss::offset_penalty_step;
use crate::shape::{OffsetBases, dim, expect_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "loss/offset_penalty";

/// The two blocks of the offsets and their weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blocks {
    /// How rows of offsets are laid out.
    pub bases: OffsetBases,
    /// Degree that the higher coefficients reach to, at most 3.
    pub degree: u32,
    /// Weight on the mean over DC offsets.
    pub dc: f32,
    /// Weight on the mean over all others.
    pub rest: f32,
}

impl Blocks {
    /// Weight of one squared element of each block, among `splats` rows.
    fn shares(&self, splats: usize) -> (f32, f32) {
        let per_coefficient = splats.max(1) as f32 * 3.0;
        let rest = match self.bases {
            OffsetBases::Dc => 0,
            OffsetBases::All => (self.degree + 1).pow(2) - 1,
        };
        let share_of_rest = if rest == 0 { 0.0 } else { self.rest / (per_coefficient * rest as f32) };
        (self.dc / per_coefficient, share_of_rest)
    }
}

/// Value and gradient.
///
/// # Shapes
/// in `offsets`, rows as the bases lay them out · out `v_offsets` like them (=) or (+=) ·
/// `term.values`, one element (=)
/// # Equation: dc · mean(Δ_dc²) + rest · mean(Δ_rest²); with weights 1 the L_off of Guard4D as means. The second
/// block ends at the degree; without one its mean is 0.
/// # Determinism: bitwise; sums in a fixed order, no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn step(
    rec: &mut Recorder,
    offsets: &Buffer<f32>,
    blocks: Blocks,
    v_offsets: &mut Buffer<f32>,
    term: Term<'_>,
    scratch: &mut SumScratch,
) -> Result<(), KernelError> {
    let row = blocks.bases.floats();
    let splats = offsets.len() / row;
    expect_len(KERNEL, "offsets", offsets, splats * row)?;
    expect_len(KERNEL, "v_offsets", v_offsets, offsets.len())?;
    term.slots(KERNEL, 1)?;
    let texels = offsets.len() / 4;
    let groups = scratch.groups(KERNEL, texels)?;
    let (dc, rest) = blocks.shares(splats);
    let spec = offset_penalty_step::Spec {
        accumulate: term.accumulate.flag(),
        texels: PER_INVOCATION,
        offset_texels: blocks.bases.texels(),
    };
    // Pieces of whole workgroups, whose texels and partial sums are then the same as in one piece; and of whole rows.
    let per_group = LANES * PER_INVOCATION as usize * blocks.bases.texels() as usize;
    for units in rec.pieces(texels.div_ceil(per_group), 4 * size_of::<f32>() * per_group) {
        let texels = units.start * per_group..(units.end * per_group).min(texels);
        let part = |buffer: &Buffer<f32>| buffer.part(4 * texels.start..4 * texels.end);
        let (before, mut after) = (part(v_offsets), part(v_offsets));
        let first_group = texels.start / (LANES * PER_INVOCATION as usize);
        let bind = offset_penalty_step::Bind {
            offsets: &part(offsets),
            v_before: &before,
            v_offsets: &mut after,
            partial: &mut scratch.partial,
        };
        let params = offset_penalty_step::Params {
            n: dim(texels.len()),
            first_group: dim(first_group),
            dc,
            rest,
            weight: term.weight,
        };
        let groups = texels.len().div_ceil(LANES * PER_INVOCATION as usize);
        rec.dispatch_spec(bind, params, spec, Grid::groups(dim(groups), 1, 1))?;
    }
    finish(rec, &scratch.partial, 0..groups * PARTIALS_PER_GROUP, 1.0, term.values, term.slot)
}
