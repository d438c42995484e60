//! Similarity transforms: turned, scaled and shifted, as assets are on their way from one program to another.

use glam::{DMat3, DQuat, DVec3};
use nalgebra::{Matrix3, Vector3};

/// A point and where it went.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// The point.
    pub from: DVec3,
    /// Where it is found.
    pub to: DVec3,
}

/// `x ↦ scale · rotation · x + translation`. Mirrors are none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Factor of all lengths, positive.
    pub scale: f64,
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Where the origin goes.
    pub translation: DVec3,
}

impl Similarity {
    /// Nothing moves.
    pub const IDENTITY: Self = Self { scale: 1.0, rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// Where `point` goes.
    #[must_use]
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.scale * (self.rotation * point) + self.translation
    }

    /// The way back.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (scale, rotation) = (1.0 / self.scale, self.rotation.inverse());
        Self { scale, rotation, translation: -scale * (rotation * self.translation) }
    }

    /// The least squares through `pairs`; `None` where they say of no scale or no rotation.
    ///
    /// # Equation
    /// Umeyama (PAMI 13, 1991), equations 40 to 42: with Σ = UDVᵀ the covariance of both, R = USVᵀ and
    /// scale = tr(DS)/σ², where S turns the smallest axis round if the rest would be a mirror.
    #[must_use]
    pub fn through(pairs: &[Pair]) -> Option<Self> {
        let count = pairs.len() as f64;
        let mean = |of: fn(&Pair) -> DVec3| pairs.iter().map(of).sum::<DVec3>() / count;
        let (from, to) = (mean(|pair| pair.from), mean(|pair| pair.to));
        let (mut covariance, mut variance) = (Matrix3::zeros(), 0.0);
        for pair in pairs {
            let [x, y] = [pair.from - from, pair.to - to];
            covariance += Vector3::from(y.to_array()) * Vector3::from(x.to_array()).transpose() / count;
            variance += x.length_squared() / count;
        }
        if !covariance.iter().all(|value: &f64| value.is_finite()) || variance <= 0.0 {
            return None;
        }
        let svd = covariance.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        let last = (u.determinant() * v_t.determinant()).signum();
        let signs = Vector3::new(1.0, 1.0, last);
        let turned = u * Matrix3::from_diagonal(&signs) * v_t;
        let rotation = DQuat::from_mat3(&DMat3::from_cols_slice(turned.as_slice())).normalize();
        let scale = svd.singular_values.dot(&signs) / variance;
        let found = Self { scale, rotation, translation: to - scale * (rotation * from) };
        (scale > 0.0 && found.translation.is_finite() && rotation.is_finite()).then_some(found)
    }
}
