//! What became of an asset's colours on the whole: a contrast and an exposure of each channel.

use crate::scene::gaussians::CHANNELS;

/// Rounds in which colours that are far off lose their say.
const ROUNDS: usize = 10;
/// Deviations from which on a colour's say falls (Huber, 1981): as good as least squares to 5 % where noise is normal.
const TUNED: f64 = 1.345;
/// Deviations of a normal distribution in its median distance from the middle.
const DEVIATION: f64 = 1.4826;
/// Least deviation, of 1: a hundredth of a level of 8 bits, below which nothing is told.
const FINEST: f64 = 0.01 / 255.0;

/// leaked ≈ slope·original + start, for each channel.
pub(super) struct Exposure([Line; CHANNELS]);

#[derive(Clone, Copy)]
struct Line {
    slope: f64,
    start: f64,
    /// Robust standard deviation of what is left.
    deviation: f64,
}

impl Exposure {
    /// From colours of the original and what they became. Colours beyond black and white say nothing, because many
    /// formats cut them off.
    pub(super) fn of(colours: &[[[f64; CHANNELS]; 2]]) -> Self {
        Self(std::array::from_fn(|channel| {
            let points = colours.iter().map(|[original, leaked]| [original[channel], leaked[channel]]);
            Line::through(&points.filter(|[original, _]| (0.0..=1.0).contains(original)).collect::<Vec<_>>())
        }))
    }

    /// What a colour became.
    pub(super) fn apply(&self, colour: [f64; CHANNELS]) -> [f64; CHANNELS] {
        std::array::from_fn(|channel| self.0[channel].at(colour[channel]))
    }

    /// How far a colour is from what the original's became, in deviations.
    pub(super) fn deviations(&self, original: [f64; CHANNELS], leaked: [f64; CHANNELS]) -> [f64; CHANNELS] {
        std::array::from_fn(|channel| {
            let line = self.0[channel];
            (leaked[channel] - line.at(original[channel])) / line.deviation
        })
    }
}

impl Line {
    /// Least squares, reweighted.
    fn through(points: &[[f64; 2]]) -> Self {
        let mut weights = vec![1.0; points.len()];
        let mut line = Self { slope: 1.0, start: 0.0, deviation: FINEST };
        for _ in 0..ROUNDS {
            line = line.weighted(points, &weights);
            for (weight, [x, y]) in weights.iter_mut().zip(points) {
                *weight = (TUNED * line.deviation / (y - line.at(*x)).abs()).min(1.0);
            }
        }
        line
    }

    /// The least squares with these weights; shifted alone where the original's colours do not vary.
    fn weighted(self, points: &[[f64; 2]], weights: &[f64]) -> Self {
        let total = weights.iter().sum::<f64>();
        if points.is_empty() {
            return self;
        }
        let mean = |of: fn(f64, f64) -> f64| {
            points.iter().zip(weights).map(|([x, y], weight)| weight * of(*x, *y)).sum::<f64>() / total
        };
        let (x, y) = (mean(|x, _| x), mean(|_, y| y));
        let (xx, xy) = (mean(|x, _| x * x) - x * x, mean(|x, y| x * y) - x * y);
        let slope = if xx > f64::EPSILON { xy / xx } else { 1.0 };
        let start = y - slope * x;
        let mut off: Vec<f64> = points.iter().map(|[x, y]| (y - slope * x - start).abs()).collect();
        let middle = off.len() / 2;
        let deviation = DEVIATION * *off.select_nth_unstable_by(middle, f64::total_cmp).1;
        Self { slope, start, deviation: deviation.max(FINEST) }
    }

    fn at(&self, colour: f64) -> f64 {
        self.slope * colour + self.start
    }
}
