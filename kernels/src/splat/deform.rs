//! Applies the heads of a deformation network to the raw splats.

use super::project::RawSplats;
use super::sh::SH_FLOATS;
use crate::error::KernelError;
use crate::registry::splat::{deform_apply, deform_sh};
use crate::shape::{dim, require_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "splat/deform";

/// Columns of the heads before the SH head: dx, do | ds, 0 | dr.
pub const GEOMETRY_COLUMNS: usize = 12;
/// Columns with the SH head; a product may pad rows beyond them.
pub const ALL_COLUMNS: usize = GEOMETRY_COLUMNS + SH_FLOATS;

/// What the rotation head does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RotationUpdate {
    /// The quaternion stays as it is.
    Keep,
    /// `quat + dr`.
    Add,
    /// The Hamilton product of the raw quaternion and `dr`, normalised.
    Multiply,
}

/// Output of the heads.
#[derive(Clone, Copy, Debug)]
pub struct Heads<'a> {
    /// `[N, columns]`; the columns of an unused head are zero.
    pub data: &'a Buffer<f32>,
    /// Length of a row: a multiple of 4, at least [`GEOMETRY_COLUMNS`].
    pub columns: usize,
}

/// Deformed splats, laid out as [`RawSplats`].
#[derive(Debug)]
pub struct DeformedOut<'a> {
    /// `[N,4]`
    pub means: &'a mut Buffer<f32>,
    /// `[N,4]`
    pub scales: &'a mut Buffer<f32>,
    /// `[N,4]`
    pub quats: &'a mut Buffer<f32>,
}

/// Adds position, scale, rotation and opacity heads to the raw splats.
///
/// # Shapes
/// in `splats` \[N,4\] each · `heads` \[N, columns\] · out `out` \[N,4\] each (=)
/// # Equation: Wu et al. 2024 (4DGaussians), on values before activation
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn apply(
    rec: &mut Recorder,
    splats: RawSplats<'_>,
    heads: Heads<'_>,
    rotation: RotationUpdate,
    out: DeformedOut<'_>,
) -> Result<(), KernelError> {
    let n = splats.means.len() / 4;
    check_heads(heads, n)?;
    for (name, len) in [
        ("scales", splats.scales.len()),
        ("quats", splats.quats.len()),
        ("deformed_means", out.means.len()),
        ("deformed_scales", out.scales.len()),
        ("deformed_quats", out.quats.len()),
    ] {
        require_len(KERNEL, name, len, 4 * n)?;
    }
    let bind = deform_apply::Bind {
        means: splats.means,
        scales: splats.scales,
        quats: splats.quats,
        heads: heads.data,
        deformed_means: out.means,
        deformed_scales: out.scales,
        deformed_quats: out.quats,
    };
    let spec = deform_apply::Spec {
        rotation: match rotation {
            RotationUpdate::Keep => 0,
            RotationUpdate::Add => 1,
            RotationUpdate::Multiply => 2,
        },
    };
    let params = deform_apply::Params { n: dim(n), head_texels: dim(heads.columns / 4) };
    rec.dispatch_spec(bind, params, spec, Grid::threads(n))
}

/// Adds the SH head to the coefficients.
///
/// # Shapes
/// in `sh_coeffs` \[N,16,3\] · `heads` \[N, columns\], at least [`ALL_COLUMNS`] · out `deformed` \[N,16,3\] (=)
/// # Equation: Wu et al. 2024 (4DGaussians)
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn apply_sh(
    rec: &mut Recorder,
    sh_coeffs: &Buffer<f32>,
    heads: Heads<'_>,
    deformed: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let n = sh_coeffs.len() / SH_FLOATS;
    check_heads(heads, n)?;
    require_len(KERNEL, "heads", heads.columns, ALL_COLUMNS)?;
    require_len(KERNEL, "deformed_sh", deformed.len(), n * SH_FLOATS)?;
    let num_texels = n * SH_FLOATS / 4;
    let params = deform_sh::Params { num_texels: dim(num_texels), head_texels: dim(heads.columns / 4) };
    let bind = deform_sh::Bind { sh_coeffs, heads: heads.data, deformed_sh: deformed };
    rec.dispatch(bind, params, Grid::threads(num_texels))
}

fn check_heads(heads: Heads<'_>, n: usize) -> Result<(), KernelError> {
    if heads.columns < GEOMETRY_COLUMNS || !heads.columns.is_multiple_of(4) {
        return Err(KernelError::Shape {
            kernel: KERNEL,
            buffer: "heads",
            got: format!("{} columns", heads.columns),
            expected: format!("a multiple of 4, at least {GEOMETRY_COLUMNS}"),
        });
    }
    require_len(KERNEL, "heads", heads.data.len(), n * heads.columns)
}
