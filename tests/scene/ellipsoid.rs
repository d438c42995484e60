//! Ellipsoids are covariances and back.

use guard4d_engine::scene::ellipsoid::{covariance, of_covariance};
use nalgebra::Matrix3;

use crate::support::close::largest;

fn apart(a: &Matrix3<f64>, b: &Matrix3<f64>) -> f64 {
    largest(a.iter().zip(b.iter()).map(|(a, b)| (a - b).abs()))
}

#[test]
fn a_covariance_is_that_of_the_splat_which_it_is_taken_apart_into() {
    // A quarter turn about z: what was along x is along y.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let turned = covariance([0.0, -1.0, -2.0], [half, 0.0, 0.0, half]);
    let expected = Matrix3::from_diagonal(&[(-2f64).exp(), 1.0, (-4f64).exp()].into());
    // Quaternions are of single precision.
    assert!(apart(&turned, &expected) < 1e-6, "{turned}");
    // Of any length, about any axis.
    let own = covariance([-0.3, -1.7, -0.9], [0.8, -0.2, 1.4, 0.5]);
    assert!(own.determinant() > 0.0 && apart(&own, &own.transpose()) < 1e-12, "{own}");
    let (scales, quat) = of_covariance(own);
    assert!(apart(&covariance(scales, quat), &own) < 1e-6, "{scales:?} {quat:?}");
    let length: f32 = quat.iter().map(|q| q * q).sum();
    assert!((length - 1.0).abs() < 1e-6, "{quat:?} is a turn");
    // A splat without any thickness has a logarithm still.
    let (scales, _) = of_covariance(Matrix3::from_diagonal(&[1.0, 1.0, 0.0].into()));
    assert!(scales.iter().all(|scale| scale.is_finite()), "{scales:?}");
}
