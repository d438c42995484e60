//! Quartiles and power laws of samples.

/// Middle half of some samples; all NaN when there are none, or when one is NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Quartiles {
    pub(crate) low: f64,
    pub(crate) median: f64,
    pub(crate) high: f64,
}

impl Quartiles {
    /// Quartiles by linear interpolation between the two nearest samples.
    pub(crate) fn of(samples: &[f64]) -> Self {
        let mut sorted = samples.to_vec();
        sorted.sort_by(f64::total_cmp);
        if sorted.is_empty() || sorted.iter().any(|s| s.is_nan()) {
            return Self { low: f64::NAN, median: f64::NAN, high: f64::NAN };
        }
        let at = |quarter: usize| {
            let place = quarter * (sorted.len() - 1);
            let (below, part) = (place / 4, (place % 4) as f64 / 4.0);
            let above = (below + 1).min(sorted.len() - 1);
            sorted[below] + part * (sorted[above] - sorted[below])
        };
        Self { low: at(1), median: at(2), high: at(3) }
    }

    /// Half of the distance between the outer quartiles, as a share of the median.
    pub(crate) fn spread(self) -> f64 {
        0.5 * (self.high - self.low) / self.median
    }
}

/// Least-squares exponent p of cost = c·size^p, that is the slope between logarithms; `None` without two different
/// sizes, or when a number is not positive.
pub(crate) fn exponent(points: &[(f64, f64)]) -> Option<f64> {
    let is_usable = |v: f64| v.is_finite() && v > 0.0;
    if points.is_empty() || !points.iter().all(|&(size, cost)| is_usable(size) && is_usable(cost)) {
        return None;
    }
    let logs: Vec<(f64, f64)> = points.iter().map(|&(size, cost)| (size.ln(), cost.ln())).collect();
    let mean = |pick: fn(&(f64, f64)) -> f64| logs.iter().map(pick).sum::<f64>() / logs.len() as f64;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let spread: f64 = logs.iter().map(|p| (p.0 - x).powi(2)).sum();
    let joint: f64 = logs.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    (spread > 0.0).then(|| joint / spread)
}
