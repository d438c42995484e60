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
        let (mut matrix, mut right) = (SMatrix::<f64, 4, 4>::zeros(), SVector::<f64, 4>::zeros());
        let shown = self.of(drawn);
        let pixels = drawn.picture.values.iter().zip(&drawn.clear.values).zip(film.values.iter().zip(&shown.values));
        for (((x, clear), (y, shown)), w) in pixels.zip(weights) {
            let [x, clear] = [x, clear].map(|value| f64::from(*value));
            let row = SVector::<f64, 4>::new(x, clear, 1.0, bend_of(x));
            matrix += *w * row * row.transpose();
            right += *w * f64::from(y - shown) * row;
        }
        let little = weights.iter().sum::<f64>() * LEAST_DEVIATION.powi(2);
        for i in 0..4 {
            matrix[(i, i)] += little;
        }
        let Some(factor) = matrix.cholesky() else { return self };
        let [gain, clear, level, bend]: [f64; 4] = factor.solve(&right).into();
        let bent = Self { gain: self.gain + gain, clear: self.clear + clear, level: self.level + level, bend };
        if (LEAST_GAIN..=MOST_GAIN).contains(&bent.gain) && bend.abs() <= MOST_BEND { bent } else { self }
    }

    fn straight(drawn: &Drawn, film: &Gray, weights: &[f64]) -> Self {
        let (mut matrix, mut right) = (SMatrix::<f64, 3, 3>::zeros(), SVector::<f64, 3>::zeros());
        let pixels = drawn.picture.values.iter().zip(&drawn.clear.values).zip(&film.values).zip(weights);
        for (((x, clear), y), w) in pixels {
            let row = SVector::<f64, 3>::new(f64::from(*x), f64::from(*clear), 1.0);
            matrix += *w * row * row.transpose();
            right += *w * f64::from(*y) * row;
        }
        // As little as rounding: where the background is all or nothing of the picture it says nothing.
        let little = weights.iter().sum::<f64>() * LEAST_DEVIATION.powi(2);
        for i in 0..3 {
            matrix[(i, i)] += little;
        }
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

/// Nothing at both ends of the levels, and a quarter between.
fn bend_of(value: f64) -> f64 {
    value * (1.0 - value)
}
