//! What was done to a film's levels, made up for.

use nalgebra::{SMatrix, SVector};

use super::gray::Gray;
use super::stage::Drawn;
use crate::base::numbers::narrow;

/// Least deviation of what differs, of 1: that of rounding and coding.
pub(super) const LEAST_DEVIATION: f64 = 0.004;
/// Contrast that a film of the asset may have: less is not of it, or fitted to nothing.
const LEAST_GAIN: f64 = 0.3;
const MOST_GAIN: f64 = 3.0;
/// Bend beyond which it is none that an edit leaves: a gamma of 1.5 has 0.6.
const MOST_BEND: f64 = 1.0;

/// What is made up for of a film's levels.
#[derive(Clone, Copy)]
pub(super) enum Levels {
    /// Contrast and brightness.
    Straight,
    /// A bend, too.
    Bent,
}

/// What was done to a film's levels.
#[derive(Clone, Copy)]
pub(super) struct Exposure {
    /// Contrast.
    pub(super) gain: f64,
    /// How much brighter than in the original the background is.
    clear: f64,
    /// Brightness.
    level: f64,
    /// How much more what is between dark and bright was raised.
    bend: f64,
}

impl Exposure {
    /// The one that fits best, by weighted least squares.
    pub(super) fn fitted(drawn: &Drawn, film: &Gray, weights: &[f64], levels: Levels) -> Self {
        let straight = Self::straight(drawn, film, weights);
        match levels {
            Levels::Straight => straight,
            Levels::Bent => straight.bent(drawn, film, weights),
        }
    }

    /// The same with as much of a bend as what is left of the film shows.
    fn bent(self, drawn: &Drawn, film: &Gray, weights: &[f64]) -> Self {
        let shown = self.of(drawn);
        let left = film.values.iter().zip(&shown.values).map(|(y, shown)| f64::from(y - shown));
        let Sums { matrix, right, .. } =
            Sums::of(drawn, left, weights, |x, clear| SVector::<f64, 4>::new(x, clear, 1.0, bend_of(x)));
        let Some(factor) = matrix.cholesky() else { return self };
        let [gain, clear, level, bend]: [f64; 4] = factor.solve(&right).into();
        let bent = Self { gain: self.gain + gain, clear: self.clear + clear, level: self.level + level, bend };
        if (LEAST_GAIN..=MOST_GAIN).contains(&bent.gain) && bend.abs() <= MOST_BEND { bent } else { self }
    }

    fn straight(drawn: &Drawn, film: &Gray, weights: &[f64]) -> Self {
        let values = film.values.iter().map(|y| f64::from(*y));
        let Sums { matrix, mut right, little } =
            Sums::of(drawn, values, weights, |x, clear| SVector::<f64, 3>::new(x, clear, 1.0));
        // From the original's own exposure.
        right[0] += little;
        let Some(factor) = matrix.cholesky() else { return Self { gain: 1.0, clear: 0.0, level: 0.0, bend: 0.0 } };
        let [gain, ..]: [f64; 3] = factor.solve(&right).into();
        let held = gain.clamp(LEAST_GAIN, MOST_GAIN);
        // The others again for the contrast that is held to.
        let rest = SMatrix::<f64, 2, 2>::new(matrix[(1, 1)], matrix[(1, 2)], matrix[(2, 1)], matrix[(2, 2)]);
        let left = SVector::<f64, 2>::new(right[1] - held * matrix[(1, 0)], right[2] - held * matrix[(2, 0)]);
        let [clear, level] = rest.cholesky().map_or([0.0; 2], |factor| factor.solve(&left).into());
        Self { gain: held, clear, level, bend: 0.0 }
    }

    pub(super) fn of(self, drawn: &Drawn) -> Gray {
        let [gain, clear, level, bend] = [self.gain, self.clear, self.level, self.bend].map(narrow);
        let pixels = drawn.picture.values.iter().zip(&drawn.clear.values);
        let value = |(x, there): (&f32, &f32)| gain * x + clear * there + level + bend * narrow(bend_of(f64::from(*x)));
        Gray { values: pixels.map(value).collect(), ..drawn.picture.clone() }
    }
}

/// Normal equations of weighted least squares in N numbers.
struct Sums<const N: usize> {
    matrix: SMatrix<f64, N, N>,
    right: SVector<f64, N>,
    /// What is added to the diagonal, as little as rounding: where the background is all or nothing of the picture it
    /// says nothing.
    little: f64,
}

impl<const N: usize> Sums<N> {
    /// Of pixels' values, each with a row that is told from the original's and from how clear that is.
    fn of(
        drawn: &Drawn,
        values: impl Iterator<Item = f64>,
        weights: &[f64],
        row_of: impl Fn(f64, f64) -> SVector<f64, N>,
    ) -> Self {
        let (mut matrix, mut right) = (SMatrix::zeros(), SVector::zeros());
        let pixels = drawn.picture.values.iter().zip(&drawn.clear.values).zip(values).zip(weights);
        for (((x, clear), value), w) in pixels {
            let row = row_of(f64::from(*x), f64::from(*clear));
            matrix += *w * row * row.transpose();
            right += *w * value * row;
        }
        let little = weights.iter().sum::<f64>() * LEAST_DEVIATION.powi(2);
        for i in 0..N {
            matrix[(i, i)] += little;
        }
        Self { matrix, right, little }
    }
}

/// Nothing at both ends of the levels, and a quarter between.
fn bend_of(value: f64) -> f64 {
    value * (1.0 - value)
}
