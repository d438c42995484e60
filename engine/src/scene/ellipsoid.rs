//! Ellipsoids of splats as covariances, and back.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

use crate::base::numbers::narrow;

/// Covariance of a splat of these log standard deviations, turned by a quaternion w, x, y, z of any length; not finite
/// for one of none.
#[must_use]
pub fn covariance(scales: [f32; 3], quat: [f32; 4]) -> Matrix3<f64> {
    let [w, x, y, z] = quat.map(f64::from);
    let turn = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)).to_rotation_matrix();
    let half = turn.matrix() * Matrix3::from_diagonal(&Vector3::from(scales.map(|scale| f64::from(scale).exp())));
    half * half.transpose()
}

/// Log standard deviations and a unit quaternion w, x, y, z of the splat that has this covariance.
#[must_use]
pub fn of_covariance(covariance: Matrix3<f64>) -> ([f32; 3], [f32; 4]) {
    let eigen = covariance.symmetric_eigen();
    let mut axes = eigen.eigenvectors;
    if axes.determinant() < 0.0 {
        axes.column_mut(0).neg_mut();
    }
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let deviations = eigen.eigenvalues.map(|variance| narrow(0.5 * variance.max(f64::MIN_POSITIVE).ln()));
    (deviations.into(), [turn.w, turn.i, turn.j, turn.k].map(narrow))
}
