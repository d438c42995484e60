//! Twin of `splat/trajectory_fwd`.

use crate::reference::real::Real;

/// Floats of a path.
const PATH_FLOATS: usize = 16;

/// Means and quats `[N,4]` at `time` of splats with paths `[N,16]` (Li et al. 2024).
#[must_use]
pub fn forward<R: Real>(means: &[R], quats: &[R], paths: &[R], time: R) -> (Vec<R>, Vec<R>) {
    let (mut moved_means, mut moved_quats) = (means.to_vec(), quats.to_vec());
    for (i, path) in paths.chunks_exact(PATH_FLOATS).enumerate() {
        let dt = time - path[3];
        for axis in 0..3 {
            // Horner's rule, as on the device: infinite times must overflow alike.
            moved_means[4 * i + axis] += dt * (path[axis] + dt * (path[4 + axis] + dt * path[8 + axis]));
        }
        let steps = dt * path[7];
        moved_means[4 * i + 3] = faded(means[4 * i + 3], steps * steps);
        for k in 0..4 {
            moved_quats[4 * i + k] += dt * path[12 + k];
        }
    }
    (moved_means, moved_quats)
}

/// Logit of `sigmoid(logit) exp(-falloff)`.
fn faded<R: Real>(logit: R, falloff: R) -> R {
    let one = R::of(1.0);
    let magnitude = logit.max(-logit);
    let log_opacity = -(-logit).max(R::of(0.0)) - (one + (-magnitude).exp()).ln();
    let (opacity, rest) = (one / (one + (-logit).exp()), one / (one + logit.exp()));
    log_opacity - falloff - (rest + opacity * (one - (-falloff).exp())).ln()
}
