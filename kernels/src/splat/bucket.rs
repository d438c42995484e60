//! Sorts by buckets of depth: renderers that sort on the CPU do so to be fast, and splats of one bucket stand in any
//! order that they came in.

use super::project::{Buckets, Projection, View};
use crate::error::KernelError;
use crate::registry::splat::bucket_keys;
use crate::shape::{dim, require_len};
use crate::vk::{Grid, Recorder};

const KERNEL: &str = "splat/bucket";

/// Bits of a bucket's number at least and at most.
const BITS: [u32; 2] = [10, 20];
/// Bins of depth, each with buckets of its own.
const BINS: f32 = 32.0;

/// Buckets of so many splats: some four splats for each.
#[must_use]
pub fn count(n: usize) -> u32 {
    let bits = (n.max(1) as f64 / 4.0).log2().round();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "10 to 20")]
    let bits = bits.clamp(f64::from(BITS[0]), f64::from(BITS[1])) as u32;
    (1 << bits) + 1
}

/// Bits of the keys of so many splats.
#[must_use]
pub fn key_bits(n: usize) -> u32 {
    u32::BITS - (count(n) + 1).leading_zeros()
}

/// Replaces the keys of a projection by buckets of depth.
///
/// # Shapes
/// in `projection.geom` \[N,8\], `buckets.along` \[N\] · out `projection.order` (=), not yet sorted
/// # Equation
/// With d = (z₁ − z) · 32 / (z₁ − z₀) for depth z between those of the scene's box, its bin b = ⌊d⌋ has a share s of
/// the buckets by how far it is from the camera's, and the bucket is Σ s over bins before it + ⌊s (d − b)⌋, counted
/// from far to near (the `PlayCanvas` engine 2.23.3, `gsplat-unified-sort-worker.js` and `gsplat-sort-bin-weights.js`).
/// # Determinism: bitwise; no atomics
///
/// # Errors
/// [`KernelError::Shape`] before anything is recorded.
pub fn forward(
    rec: &mut Recorder,
    view: &View,
    buckets: &Buckets,
    n: usize,
    projection: &mut Projection,
) -> Result<(), KernelError> {
    require_len(KERNEL, "along", buckets.along.len(), n)?;
    require_len(KERNEL, "geom", projection.geom.len(), 8 * n)?;
    require_len(KERNEL, "order", projection.order.capacity(), n)?;
    let bind = bucket_keys::Bind {
        geom: &projection.geom,
        along: &buckets.along,
        keys: &mut projection.order.keys,
        order: &mut projection.order.values,
    };
    rec.dispatch(bind, params(view, buckets, n), Grid::threads(n))
}

fn params(view: &View, buckets: &Buckets, n: usize) -> bucket_keys::Params {
    let [x, y, z, shift] = view.world_to_camera[2];
    let along = |side: usize| {
        let pick = |axis: usize, slope: f32| slope * buckets.corners[usize::from((slope > 0.0) == (side == 1))][axis];
        pick(0, x) + pick(1, y) + pick(2, z) + shift
    };
    let (nearest, farthest) = (along(0), along(1));
    let bins_per_unit = BINS / (farthest - nearest).max(f32::MIN_POSITIVE);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 31")]
    let camera_bin = (farthest * bins_per_unit).floor().clamp(0.0, BINS - 1.0) as u32;
    bucket_keys::Params { n: dim(n), buckets: count(n), camera_bin, farthest, bins_per_unit }
}
