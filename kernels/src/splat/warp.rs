//! Applies the heads of a deformation MLP to activated splats.

use super::deform::DeformedOut;
use super::project::RawSplats;
use crate::error::KernelError;
use crate::registry::splat::warp_apply;
use crate::shape::{dim, require_len};
use crate::vk::{Buffer, Grid, Recorder};

const KERNEL: &str = "splat/warp";

/// Columns of the heads: dx or v, 0 | ds, 0 | dr | w, 0.
pub const WARP_COLUMNS: usize = 16;

/// What the position head means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shift {
    /// An offset.
    Offset,
    /// A screw motion: the twist's v in the first columns, its w in the last.
    Screw,
}

/// Adds the heads to means, standard deviations and unit quaternions. What comes out keeps the length of its
/// quaternions, as the fourth value of `scales` tells the projection.
///
/// # Shapes
/// in `splats` \[N,4\] each · `heads` \[N,16\] · out `out` \[N,4\] each (=)
/// # Equation: Yang et al. 2024 (Deformable 3D Gaussians), on values after activation
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn apply(
    rec: &mut Recorder,
    splats: RawSplats<'_>,
    heads: &Buffer<f32>,
    shift: Shift,
    out: DeformedOut<'_>,
) -> Result<(), KernelError> {
    let n = splats.means.len() / 4;
    for (name, len) in [
        ("scales", splats.scales.len()),
        ("quats", splats.quats.len()),
        ("warped_means", out.means.len()),
        ("warped_scales", out.scales.len()),
        ("warped_quats", out.quats.len()),
    ] {
        require_len(KERNEL, name, len, 4 * n)?;
    }
    require_len(KERNEL, "heads", heads.len(), WARP_COLUMNS * n)?;
    let bind = warp_apply::Bind {
        means: splats.means,
        scales: splats.scales,
        quats: splats.quats,
        heads,
        warped_means: out.means,
        warped_scales: out.scales,
        warped_quats: out.quats,
    };
    let spec = warp_apply::Spec { screw: u32::from(shift == Shift::Screw) };
    rec.dispatch_spec(bind, warp_apply::Params { n: dim(n) }, spec, Grid::threads(n))
}
