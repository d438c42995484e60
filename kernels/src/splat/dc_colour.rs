//! Colours under offsets of the DC term alone: what a view adds to them is a constant.

use crate::error::KernelError;
use crate::registry::splat::{dc_colour_bwd, dc_colour_fwd};
use crate::shape::{dim, require_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "splat/dc_colour";

/// Visible splats with their unmarked colours.
#[derive(Clone, Copy, Debug)]
pub struct BaseColours<'a> {
    /// Unmarked colours before the clamp `[V,4]`, as [`super::sh::before_clamp`] gives them.
    pub base: &'a Buffer<f32>,
    /// Row of each visible splat in the offsets `[V]`.
    pub splat_from_visible: &'a Buffer<u32>,
    /// V.
    pub count: usize,
    /// Largest value of a channel; infinite in Kerbl et al. 2023.
    pub max_colour: f32,
}

fn check(visible: &BaseColours<'_>, colours: usize) -> Result<(), KernelError> {
    require_len(KERNEL, "base", visible.base.len(), 4 * visible.count)?;
    require_len(KERNEL, "splat_from_visible", visible.splat_from_visible.len(), visible.count)?;
    require_len(KERNEL, "colours", colours, 4 * visible.count)
}

/// Colours of the visible splats. That the offsets have a row for each of them is the caller's part.
///
/// # Shapes
/// in `visible` \[V\] · `offsets` \[N,4\], none for the unmarked colours · out `colours` \[V,4\] (=), fourth channel 0
/// # Equation: `max(0, base + Y_0 delta)`, at most `max_colour`: Kerbl et al. 2023 with an offset on h_0
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    visible: &BaseColours<'_>,
    offsets: Option<&Buffer<f32>>,
    colours: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    check(visible, colours.len())?;
    let bind = dc_colour_fwd::Bind {
        base: visible.base,
        offsets: offsets.unwrap_or(visible.base),
        splat_from_visible: visible.splat_from_visible,
        colours,
    };
    let spec = dc_colour_fwd::Spec { has_offsets: offsets.is_some().into() };
    let params = dc_colour_fwd::Params { num_visible: dim(visible.count), max_colour: visible.max_colour };
    rec.dispatch_spec(bind, params, spec, Grid::threads(visible.count))
}

/// Gradient of the offsets.
///
/// # Shapes
/// in `visible` \[V\] · `offsets` \[N,4\] · `v_colours` \[V,4\], fourth channel unread · out `v_offsets` \[N,4\] (+=)
/// # Equation: `v_delta += Y_0 v_colour`, per channel nothing where the colour is clamped
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn backward(
    rec: &mut Recorder,
    visible: &BaseColours<'_>,
    offsets: &Buffer<f32>,
    v_colours: &Buffer<f32>,
    v_offsets: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    check(visible, v_colours.len())?;
    require_len(KERNEL, "v_offsets", v_offsets.len(), offsets.len())?;
    let before = v_offsets.alias();
    let bind = dc_colour_bwd::Bind {
        base: visible.base,
        offsets,
        v_colours,
        splat_from_visible: visible.splat_from_visible,
        v_before: &before,
        v_offsets,
    };
    let params = dc_colour_bwd::Params { num_visible: dim(visible.count), max_colour: visible.max_colour };
    rec.dispatch(bind, params, Grid::threads(visible.count))
}
