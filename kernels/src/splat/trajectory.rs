//! Splats on polynomial paths.

use crate::error::KernelError;
use crate::registry::splat::trajectory_fwd;
use crate::shape::{dim, require_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "splat/trajectory";

/// Floats of a path: three rows of a position's coefficients, each with a fourth value, then the turn.
pub const PATH_FLOATS: usize = 16;

/// Splats with their paths.
#[derive(Clone, Copy, Debug)]
pub struct Paths<'a> {
    /// `[N,4]`: x, y, z, opacity logit.
    pub means: &'a Buffer<f32>,
    /// `[N,4]`: w, x, y, z.
    pub quats: &'a Buffer<f32>,
    /// `[N,16]`: motion by dt and the time of most opacity; motion by dt² and the reciprocal of the duration; motion by
    /// dt³ and 0; turn of the quaternion by dt.
    pub paths: &'a Buffer<f32>,
}

/// Means and rotations at `time`; the opacity fades with the square of the time from its most.
///
/// # Shapes
/// in `splats` · out `moved_means`, `moved_quats` \[N,4\] (=)
/// # Equation: Li et al. 2024 (SpacetimeGaussians), eqs. 6 to 9
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    splats: Paths<'_>,
    time: f32,
    moved_means: &mut Buffer<f32>,
    moved_quats: &mut Buffer<f32>,
) -> Result<(), KernelError> {
    let n = splats.means.len() / 4;
    require_len(KERNEL, "quats", splats.quats.len(), 4 * n)?;
    require_len(KERNEL, "paths", splats.paths.len(), PATH_FLOATS * n)?;
    require_len(KERNEL, "moved_means", moved_means.len(), 4 * n)?;
    require_len(KERNEL, "moved_quats", moved_quats.len(), 4 * n)?;
    let Paths { means, quats, paths } = splats;
    let bind = trajectory_fwd::Bind { means, quats, paths, moved_means, moved_quats };
    rec.dispatch(bind, trajectory_fwd::Params { n: dim(n), time }, Grid::threads(n))
}
