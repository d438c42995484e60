//! Exact tail probabilities of message tests.
//!
//! If the message is uniform and independent of both clip and extractor, then for *any* extractor
//! (biased, correlated bits) every bit matches with probability ½ independently of the others, so both
//! tests below have exact p-values, counted in integers.

use super::message::{MAX_MESSAGE_BITS, Message};
use crate::error::EngineError;

/// Levels into which the largest logit is divided by [`SoftScoreNull`].
const LOGIT_LEVELS: f64 = 1023.0;

/// Natural logarithm at which [`binomial_tail`] stops adding terms: below it a term is 0 in f64.
const LOG_UNDERFLOW: f64 = -745.2;

/// Probability that at least `matches` of `num_bits` bits match by chance.
///
/// # Equation
/// p = Σ_{j ≥ k} C(L, j) / 2^L. The sum is exact; the result is rounded once.
/// Degenerate: 1 for `matches` = 0, 0 for `matches` > `num_bits`.
///
/// # Panics
/// If `num_bits` exceeds [`MAX_MESSAGE_BITS`], which no [`Message`] does.
#[must_use]
pub fn match_p_value(matches: u32, num_bits: u32) -> f64 {
    if matches == 0 {
        return 1.0;
    }
    let row = binomial_row(num_bits);
    let tail: u128 = row.iter().skip(matches as usize).sum();
    ratio(tail, num_bits)
}

/// Fewest matches whose p-value is at most `fpr`; `None` if even all bits do not suffice, or for NaN.
#[must_use]
pub fn required_matches(num_bits: u32, fpr: f64) -> Option<u32> {
    (0..=num_bits).find(|&k| match_p_value(k, num_bits) <= fpr)
}

/// False-positive rates at which thresholds are shown.
pub const SHOWN_RATES: [f64; 3] = [1e-3, 1e-6, 1e-9];

/// Fewest matches of `num_bits` at each of [`SHOWN_RATES`], for a message that was chosen from `searched` after
/// reading.
#[must_use]
pub fn shown_thresholds(num_bits: u32, searched: u32) -> [Option<u32>; 3] {
    SHOWN_RATES.map(|fpr| required_matches(num_bits, fpr / f64::from(searched)))
}

/// p-value of the best of `searched` messages, from that of one message fixed beforehand (union bound, at most 1).
#[must_use]
pub fn after_search(p_value: f64, searched: u32) -> f64 {
    // Unlike `min`, `clamp` keeps a NaN, which no threshold is ever reached by.
    (p_value * f64::from(searched)).clamp(0.0, 1.0)
}

/// Range of match counts that chance stays inside with the probability `confidence` or more, with at
/// most (1 − confidence)/2 on either side. A count outside it on *either* side says something about
/// the message: bits that are consistently wrong tell as much as bits that are right.
///
/// Up to [`MAX_MESSAGE_BITS`] it is exact; beyond, for the bits of several clips together, its tails have
/// [`binomial_tail`]'s accuracy.
///
/// # Errors
/// [`EngineError::Usage`] unless `confidence` is in [0, 1).
pub fn chance_band(num_bits: u32, confidence: f64) -> Result<std::ops::RangeInclusive<u32>, EngineError> {
    if !(0.0..1.0).contains(&confidence) {
        return Err(EngineError::Usage {
            what: "confidence of the chance band".to_owned(),
            got: confidence.to_string(),
            expected: "0 to 1, without 1".to_owned(),
        });
    }
    let tail = |matches| match num_bits {
        0..=MAX_MESSAGE_BITS => match_p_value(matches, num_bits),
        _ => binomial_tail(matches, num_bits, 0.5),
    };
    // The tail falls with the count, so the first count below the rate is found by bisection.
    let (mut low, mut above) = (0, num_bits + 1);
    while low < above {
        let middle = low + (above - low) / 2;
        if tail(middle) <= (1.0 - confidence) / 2.0 { above = middle } else { low = middle + 1 }
    }
    let high = above.saturating_sub(1);
    Ok(num_bits - high..=high)
}

/// Conservative estimate of a false-positive rate from a count: (1 + FP) / (1 + n).
#[must_use]
pub fn empirical_fpr_bound(false_positives: u32, num_trials: u32) -> f64 {
    (1.0 + f64::from(false_positives)) / (1.0 + f64::from(num_trials))
}

/// Probability of at least `successes` among `num_trials` independent trials of probability `rate`.
///
/// # Equation
/// Terms in log space, largest exponents first; relative error below 1e-9 for 10,000 trials.
/// Degenerate: 1 for `successes` = 0; NaN for a NaN `rate`.
#[must_use]
pub fn binomial_tail(successes: u32, num_trials: u32, rate: f64) -> f64 {
    if rate.is_nan() {
        return f64::NAN;
    }
    if successes == 0 || rate >= 1.0 {
        return if successes <= num_trials { 1.0 } else { 0.0 };
    }
    if rate <= 0.0 {
        return 0.0;
    }
    let odds = rate.ln() - (-rate).ln_1p();
    let mut log_term = f64::from(num_trials) * (-rate).ln_1p();
    let mut tail = 0.0;
    for j in 0..=num_trials {
        if j >= successes && log_term > LOG_UNDERFLOW {
            tail += log_term.exp();
        }
        log_term += f64::from(num_trials - j).ln() - f64::from(j + 1).ln() + odds;
    }
    tail.min(1.0)
}

/// Exact distribution of the soft score S = Σ (2mⱼ − 1) oⱼ over uniformly random messages m.
///
/// The logits oⱼ are first rounded to integers in ±1023 relative to the largest. The score of the
/// rounded logits is itself a function of the clip alone, so its randomisation test is exact, not
/// approximate; rounding costs a little resolution and buys a table of integer counts that reaches
/// 2⁻¹²⁸ at every length, where enumeration ends near 40 bits and Monte Carlo near 1/n.
/// Ties count against the mark.
#[derive(Clone, Debug)]
pub struct SoftScoreNull {
    weights: Vec<u32>,
    signs: Vec<bool>,
    /// `tail[x]` = number of messages whose agreeing weights sum to `x` or more.
    tail: Vec<u128>,
}

impl SoftScoreNull {
    /// Tabulates the distribution for a clip's mean logits, first bit first.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] for a NaN or infinite logit, [`EngineError::Usage`] for no or more than
    /// [`MAX_MESSAGE_BITS`] logits.
    pub fn new(mean_logits: &[f64]) -> Result<Self, EngineError> {
        if mean_logits.is_empty() || mean_logits.len() > MAX_MESSAGE_BITS as usize {
            return Err(EngineError::Usage {
                what: "logits of a clip".to_owned(),
                got: mean_logits.len().to_string(),
                expected: format!("1 to {MAX_MESSAGE_BITS}"),
            });
        }
        let weights = integer_weights(mean_logits)?;
        let signs = mean_logits.iter().map(|&o| o > 0.0).collect();
        let total: u32 = weights.iter().sum();
        let mut counts = vec![0_u128; total as usize + 1];
        counts[0] = 1;
        let mut reached = 0;
        for &weight in weights.iter().filter(|&&weight| weight > 0) {
            let weight = weight as usize;
            reached += weight;
            for sum in (weight..=reached).rev() {
                counts[sum] += counts[sum - weight];
            }
        }
        for sum in (1..counts.len().saturating_sub(1)).rev() {
            counts[sum] += counts[sum + 1];
        }
        Ok(Self { weights, signs, tail: counts })
    }

    /// Probability that a random message agrees with the logits at least as well as this one.
    /// Degenerate: 1 if nothing agrees, in particular if all logits are 0.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the message's length is not the number of logits.
    pub fn p_value(&self, message: &Message) -> Result<f64, EngineError> {
        if message.num_bits() as usize != self.weights.len() {
            return Err(EngineError::Usage {
                what: "message".to_owned(),
                got: format!("{} bits", message.num_bits()),
                expected: format!("{} bits, one per logit", self.weights.len()),
            });
        }
        let agreeing: u32 = message
            .bits()
            .zip(self.signs.iter().zip(&self.weights))
            .map(|(bit, (&sign, &weight))| if bit == sign { weight } else { 0 })
            .sum();
        if agreeing == 0 {
            return Ok(1.0);
        }
        let num_voting = self.weights.iter().filter(|&&weight| weight > 0).count();
        let num_voting = u32::try_from(num_voting).expect("at most 128 weights exist");
        Ok(ratio(self.tail[agreeing as usize], num_voting))
    }
}

fn integer_weights(mean_logits: &[f64]) -> Result<Vec<u32>, EngineError> {
    if let Some(bit) = mean_logits.iter().position(|o| !o.is_finite()) {
        return Err(EngineError::NotFinite { what: format!("mean logit of bit {bit}"), got: mean_logits[bit] });
    }
    let largest = mean_logits.iter().fold(0.0_f64, |max, o| max.max(o.abs()));
    if largest == 0.0 {
        return Ok(vec![0; mean_logits.len()]);
    }
    let level = |o: &f64| (o.abs() / largest * LOGIT_LEVELS).round();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a rounded number in 0..=1023 is exact in u32"
    )]
    Ok(mean_logits.iter().map(|o| level(o) as u32).collect())
}

/// Row `num_bits` of Pascal's triangle; its largest entry, C(128, 64) ≈ 2.4e37, fits u128.
fn binomial_row(num_bits: u32) -> Vec<u128> {
    assert!(num_bits <= MAX_MESSAGE_BITS, "no message has {num_bits} bits");
    let mut row = vec![0; num_bits as usize + 1];
    row[0] = 1_u128;
    for n in 1..row.len() {
        for j in (1..=n).rev() {
            row[j] += row[j - 1];
        }
    }
    row
}

/// `count / 2^num_bits`: one rounding, then an exact division.
fn ratio(count: u128, num_bits: u32) -> f64 {
    count as f64 / 2.0_f64.powi(num_bits.cast_signed())
}
