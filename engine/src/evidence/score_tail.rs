//! How likely a score is by chance, when it is a sum of independent terms that take one of two values each.
//!
//! The bound is a proof for any terms and any number of them; the saddle-point estimate is closer and proves nothing.

use std::f64::consts::PI;

/// Times that the search for the best exponent doubles or halves its interval: f64 tells no more apart.
const HALVINGS: usize = 200;
/// Distance from the score, in standard deviations, at which the search ends. Any exponent gives a valid bound, so that
/// this costs tightness alone, some 1e-12 of the logarithm.
const CLOSE: f64 = 1e-6;
/// What the sums below may be off by, as a share of their terms: half a unit in the last place each, over the 2^20
/// positions of a large code with room to spare. It is added to the bound.
const ROUNDING: f64 = 1e-9;
/// Up to here the series of the normal tail converges in few terms, beyond it the continued fraction does.
const SERIES_UP_TO: f64 = 2.5;
/// Terms of either, many more than f64 wants.
const NORMAL_TERMS: u32 = 200;

/// A term of a score: `high` with a probability, otherwise `low`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwoValued {
    /// Its value with `probability`.
    pub high: f64,
    /// Its value otherwise.
    pub low: f64,
    /// In 0..1.
    pub probability: f64,
}

/// The distribution of a score by chance.
#[derive(Clone, Debug)]
pub struct ScoreTail {
    terms: Vec<TwoValued>,
}

/// Natural logarithms of the probability that a score is reached by chance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LogTail {
    /// The probability is at most this (Chernoff 1952), whatever the terms are.
    pub bound: f64,
    /// About this (Lugannani and Rice 1980).
    pub estimate: f64,
}

/// The logarithm of the mean of exp(l X), and its first two derivatives by l.
#[derive(Clone, Copy)]
struct Cumulant {
    value: f64,
    first: f64,
    second: f64,
}

impl ScoreTail {
    /// Of the sum of `terms`.
    #[must_use]
    pub fn new(terms: Vec<TwoValued>) -> Self {
        Self { terms }
    }

    /// The mean score by chance.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.cumulant(0.0).first
    }

    /// The standard deviation of the score by chance.
    #[must_use]
    pub fn deviation(&self) -> f64 {
        self.cumulant(0.0).second.sqrt()
    }

    /// How likely `score` or more is by chance; NaN for a score or terms that are NaN.
    ///
    /// # Equation
    /// ln p ≤ K(l) − l·score for every l ≥ 0, here for K′(l) = score, with K(l) = Σ ln(p e^{l·high} + (1−p) e^{l·low}).
    /// Estimate: Q(w) + φ(w)(1/v − 1/w), w = √(2(l·score − K)), v = l √K″.
    /// Degenerate: bound 0 and estimate ln ½ for a score that is no more than the mean.
    #[must_use]
    pub fn log_tail(&self, score: f64) -> LogTail {
        let at_rest = self.cumulant(0.0);
        if score.is_nan() || at_rest.first.is_nan() {
            return LogTail { bound: f64::NAN, estimate: f64::NAN };
        }
        if score <= at_rest.first {
            return LogTail { bound: 0.0, estimate: 0.5f64.ln() };
        }
        let (l, k) = self.tilted(|k, _| k.first - score, CLOSE * at_rest.second.sqrt());
        let exponent = l * score - k.value;
        let slack = ROUNDING * (k.value.abs() + l * score.abs());
        LogTail { bound: (slack - exponent).min(0.0), estimate: saddle_point(exponent, l * k.second.sqrt()) }
    }

    /// Least score whose bound is at most `log_p`; `None` where no score has one so small.
    #[must_use]
    pub fn required_score(&self, log_p: f64) -> Option<f64> {
        let bound = |k: Cumulant, l: f64| k.value - l * k.first;
        let (l, k) = self.tilted(|k, l| log_p - bound(k, l), 0.0);
        // The search ends on either side of what it seeks.
        let score = k.first + CLOSE * self.deviation();
        (bound(k, l) <= log_p + CLOSE && self.log_tail(score).bound <= log_p).then_some(score)
    }

    /// The exponent l ≥ 0 at which `off`, which grows with it, is 0 or at most `close` beside it.
    fn tilted(&self, off: impl Fn(Cumulant, f64) -> f64, close: f64) -> (f64, Cumulant) {
        let (mut low, mut high) = (0.0, 1.0 / self.deviation().max(f64::MIN_POSITIVE));
        for _ in 0..HALVINGS {
            let k = self.cumulant(high);
            // Where nothing varies every term has its larger value, and nothing moves any more.
            if off(k, high) >= 0.0 || k.second <= 0.0 || high >= f64::MAX / 4.0 {
                break;
            }
            (low, high) = (high, 2.0 * high);
        }
        for _ in 0..HALVINGS {
            let l = f64::midpoint(low, high);
            let k = self.cumulant(l);
            let away = off(k, l);
            if away.abs() <= close || l <= low || l >= high {
                return (l, k);
            }
            if away < 0.0 { low = l } else { high = l }
        }
        (high, self.cumulant(high))
    }

    fn cumulant(&self, l: f64) -> Cumulant {
        let mut sum = Cumulant { value: 0.0, first: 0.0, second: 0.0 };
        for &TwoValued { high, low, probability } in &self.terms {
            let top = (l * high).max(l * low);
            let [a, b] = [probability * (l * high - top).exp(), (1.0 - probability) * (l * low - top).exp()];
            let share = a / (a + b);
            sum.value += top + (a + b).ln();
            sum.first += low + share * (high - low);
            sum.second += share * (1.0 - share) * (high - low).powi(2);
        }
        sum
    }
}

/// ln(Q(w) + φ(w)(1/v − 1/w)) for w = √(2·`exponent`), where Q is the normal tail and φ its density.
fn saddle_point(exponent: f64, v: f64) -> f64 {
    let w = (2.0 * exponent.max(0.0)).sqrt();
    let density = -exponent - 0.5 * (2.0 * PI).ln();
    // So near to the mean both fractions are larger than what is left of them.
    let correction = if w < CLOSE { 0.0 } else { 1.0 / v - 1.0 / w };
    density + (mills_ratio(w) + correction).ln()
}

/// Q(w)/φ(w) for w ≥ 0: a series (Marsaglia 2004), or Laplace's continued fraction.
fn mills_ratio(w: f64) -> f64 {
    if w <= SERIES_UP_TO {
        let (mut term, mut sum) = (w, w);
        for k in 1..NORMAL_TERMS {
            term *= w * w / f64::from(2 * k + 1);
            sum += term;
        }
        return 0.5 * (2.0 * PI).sqrt() * (0.5 * w * w).exp() - sum;
    }
    let fraction = (1..NORMAL_TERMS).rev().fold(w, |below, k| w + f64::from(k) / below);
    1.0 / fraction
}
