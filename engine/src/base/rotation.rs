//! Random rotations.

use nalgebra::{DMatrix, DVector};
use rand_chacha::ChaCha20Rng;

use crate::base::prf::standard_normal;

/// The coordinates that a calibration mixed by another key has: a rotation of a rotated frame is one more rotation.
///
/// # Shapes
/// in `coordinates` \[L\] · out \[L\]
pub fn remix(coordinates: &[f64], rng: &mut ChaCha20Rng) -> Vec<f64> {
    let mixed = random_rotation(coordinates.len(), rng).tr_mul(&DVector::from_column_slice(coordinates));
    mixed.iter().copied().collect()
}

/// A uniformly distributed rotation (QR of a Gaussian matrix, with the signs of R's diagonal).
pub fn random_rotation(n: usize, rng: &mut ChaCha20Rng) -> DMatrix<f64> {
    let gaussian = DMatrix::from_fn(n, n, |_, _| standard_normal(rng));
    let (mut q, r) = gaussian.qr().unpack();
    for j in 0..n {
        if r[(j, j)] < 0.0 {
            q.column_mut(j).neg_mut();
        }
    }
    q
}
