//! View-dependent colours from spherical harmonics.

use std::ops::Range;

use crate::error::KernelError;
use crate::registry::splat::{sh_bwd, sh_fwd};
use crate::shape::{OffsetBases, dim, require_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "splat/sh";
/// Floats of one row of spherical-harmonic coefficients: all bases, 3 channels.
pub const SH_FLOATS: usize = OffsetBases::All.floats();
/// Bytes of a splat's coefficients; its offsets are no more.
const ROW_BYTES: usize = SH_FLOATS * size_of::<f32>();

/// Coefficients and offsets that colours are computed from.
#[derive(Clone, Copy, Debug)]
pub struct ShInputs<'a> {
    /// Coefficients h `[N,16,3]`.
    pub sh_coeffs: &'a Buffer<f32>,
    /// Offsets added to them, N rows as the bases lay them out; `None` for the unmarked colours.
    pub offsets: Option<(&'a Buffer<f32>, OffsetBases)>,
    /// Degree to evaluate, at most 3.
    pub degree: u32,
    /// Largest value of a channel; infinite in Kerbl et al. 2023.
    pub max_colour: f32,
}

/// Splats that a view sees.
#[derive(Clone, Copy, Debug)]
pub struct VisibleSplats<'a> {
    /// Unit vectors from the camera to the means `[V,4]`.
    pub dirs: &'a Buffer<f32>,
    /// Row of each visible splat in the coefficients `[V]`.
    pub splat_from_visible: &'a Buffer<u32>,
    /// V.
    pub count: usize,
}

fn check(sh: &ShInputs<'_>, visible: &VisibleSplats<'_>, colours: usize) -> Result<(), KernelError> {
    require_len(KERNEL, "dirs", visible.dirs.len(), 4 * visible.count)?;
    require_len(KERNEL, "splat_from_visible", visible.splat_from_visible.len(), visible.count)?;
    require_len(KERNEL, "colours", colours, 4 * visible.count)?;
    let coeffs = sh.sh_coeffs.len();
    if sh.degree > 3 || !coeffs.is_multiple_of(SH_FLOATS) {
        return Err(KernelError::Shape {
            kernel: KERNEL,
            buffer: "sh_coeffs",
            got: format!("[{coeffs}], degree {}", sh.degree),
            expected: format!("rows of {SH_FLOATS}, degree 0 to 3"),
        });
    }
    let Some((offsets, bases)) = sh.offsets else { return Ok(()) };
    require_len(KERNEL, "offsets", offsets.len(), coeffs / SH_FLOATS * bases.floats())
}

/// Colours of the visible splats.
///
/// # Shapes
/// in `sh` \[N,16,3\] · `visible` \[V\] · out `colours` \[V,4\] (=), fourth channel 0
/// # Equation: `max(0, 1/2 + sum_j Y_j(d) (h_j + delta_j))`, Kerbl et al. 2023, at most `max_colour`
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    sh: &ShInputs<'_>,
    visible: &VisibleSplats<'_>,
    colours: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    evaluate(rec, sh, visible, colours, true)
}

/// The same before the clamp, which is what offsets can be added to.
///
/// # Shapes
/// in `sh` \[N,16,3\] · `visible` \[V\] · out `colours` \[V,4\] (=), fourth channel 0
/// # Equation: `1/2 + sum_j Y_j(d) (h_j + delta_j)`
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn before_clamp(
    rec: &mut Recorder,
    sh: &ShInputs<'_>,
    visible: &VisibleSplats<'_>,
    colours: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    evaluate(rec, sh, visible, colours, false)
}

fn evaluate(
    rec: &mut Recorder,
    sh: &ShInputs<'_>,
    visible: &VisibleSplats<'_>,
    colours: &mut Buffer<f32>,
    clamp: bool,
) -> Result<(), KernelError> {
    check(sh, visible, colours.len())?;
    let offset_texels = sh.offsets.map_or(0, |(_, bases)| bases.texels());
    let spec = sh_fwd::Spec { degree: sh.degree, offset_texels, clamp: clamp.into() };
    for splats in rec.pieces(sh.sh_coeffs.len() / SH_FLOATS, ROW_BYTES) {
        let coeffs = sh.sh_coeffs.part(SH_FLOATS * splats.start..SH_FLOATS * splats.end);
        let bind = sh_fwd::Bind {
            sh_coeffs: &coeffs,
            offsets: &sh.offsets.map_or(coeffs.alias(), |(o, bases)| rows(o, bases, &splats)),
            dirs: visible.dirs,
            splat_from_visible: visible.splat_from_visible,
            colours,
        };
        let (first_splat, num_splats) = (dim(splats.start), dim(splats.len()));
        let (num_visible, max_colour) = (dim(visible.count), sh.max_colour);
        let params = sh_fwd::Params { num_visible, first_splat, num_splats, max_colour };
        rec.dispatch_spec(bind, params, spec, Grid::threads(visible.count))?;
    }
    Ok(())
}

/// The rows of offsets that belong to some splats.
fn rows(offsets: &Buffer<f32>, bases: OffsetBases, splats: &Range<usize>) -> Buffer<f32> {
    offsets.part(bases.floats() * splats.start..bases.floats() * splats.end)
}

/// Gradient of the offsets.
///
/// # Shapes
/// in `sh` \[N,16,3\] with offsets · `visible` \[V\] · `v_colours` \[V,4\] · out `v_offsets` like the offsets (+=);
/// coefficients above the degree are left alone
/// # Equation: `v_delta_j += Y_j(d) v_colour`, per channel nothing where the colour is clamped
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded, also when `sh` has no offsets.
pub fn backward(
    rec: &mut Recorder,
    sh: &ShInputs<'_>,
    visible: &VisibleSplats<'_>,
    v_colours: &Buffer<f32>,
    v_offsets: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    check(sh, visible, v_colours.len())?;
    let Some((offsets, bases)) = sh.offsets else {
        return Err(KernelError::Shape {
            kernel: KERNEL,
            buffer: "offsets",
            got: "none".to_owned(),
            expected: "offsets to differentiate".to_owned(),
        });
    };
    require_len(KERNEL, "v_offsets", v_offsets.len(), sh.sh_coeffs.len() / SH_FLOATS * bases.floats())?;
    let spec = sh_bwd::Spec { degree: sh.degree, offset_texels: bases.texels() };
    for splats in rec.pieces(sh.sh_coeffs.len() / SH_FLOATS, ROW_BYTES) {
        let before = rows(v_offsets, bases, &splats);
        let bind = sh_bwd::Bind {
            sh_coeffs: &sh.sh_coeffs.part(SH_FLOATS * splats.start..SH_FLOATS * splats.end),
            offsets: &rows(offsets, bases, &splats),
            dirs: visible.dirs,
            v_colours,
            splat_from_visible: visible.splat_from_visible,
            v_before: &before,
            v_offsets: &mut before.alias(),
        };
        let (first_splat, num_splats) = (dim(splats.start), dim(splats.len()));
        let (num_visible, max_colour) = (dim(visible.count), sh.max_colour);
        let params = sh_bwd::Params { num_visible, first_splat, num_splats, max_colour };
        rec.dispatch_spec(bind, params, spec, Grid::threads(visible.count))?;
    }
    Ok(())
}
