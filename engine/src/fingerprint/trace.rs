//! Which copies a film shows: all of them are scored on the device, and the best once more in full on the host.

use std::ops::Range;

use guard4d_kernels::code::copy_score::{self, BLOCK_CHIPS, Chips, KEY_WORDS};
use guard4d_kernels::{Buffer, Device};

use rayon::prelude::*;
use serde::Serialize;

use super::code::Position;
use super::issue::Issue;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::evidence::score_tail::ScoreTail;

/// Copies that are scored in one go: their keys take 8 MiB.
const AT_ONCE: u64 = 1 << 18;
/// Copies whose scores are worked out in full.
const LOOKED_AT: usize = 16;

/// A copy and how well a film fits it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scored {
    /// Its number.
    pub copy: u64,
    /// Its score in standard deviations of scores by chance.
    pub score: f64,
    /// Natural logarithm of the bound on the probability that any of all copies looked at scores so high by chance.
    pub log_p_family: f64,
    /// The same by the saddle point, which is closer and proves nothing.
    pub log_p_estimate: f64,
}

/// First of the numbers that no copy ever has: what they score is what chance does.
const DECOYS_FROM: u64 = 1 << 40;

/// What scores by chance look like, of copies that were never made.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Decoys {
    /// How many were scored.
    pub count: u64,
    /// Mean score, in standard deviations: 0 but for chance.
    pub mean: f64,
    /// Mean square of the score: 1 but for chance.
    pub variance: f64,
    /// The largest.
    pub largest: f64,
    /// How many scored so high, in steps of half a deviation from −6 to 6; the outermost have all beyond, too.
    pub counts: [u64; DECOY_BINS],
}

/// Steps of half a deviation that decoys' scores are counted in, half of them below 0.
pub const DECOY_BINS: usize = 24;

impl Decoys {
    /// Of scores in standard deviations.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "kept among the steps")]
    pub fn of(scores: &[f64]) -> Self {
        let n = scores.len().max(1) as f64;
        let sum = |of: fn(f64) -> f64| scores.iter().map(|score| of(*score)).sum::<f64>() / n;
        let largest = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut counts = [0; DECOY_BINS];
        for score in scores {
            let step = (2.0 * score).floor() + (DECOY_BINS / 2) as f64;
            counts[step.clamp(0.0, (DECOY_BINS - 1) as f64) as usize] += 1;
        }
        Self { count: scores.len() as u64, mean: sum(|t| t), variance: sum(|t| t * t), largest, counts }
    }
}

/// Scores copies of an issue against evidence.
#[derive(Debug)]
pub struct Scorer<'a> {
    device: Device,
    issue: &'a Issue<'a>,
    evidence: &'a [f64],
    chance: ScoreTail,
    deviation: f64,
    biases: Buffer<u32>,
    weights: Buffer<f32>,
    /// What every score has besides: that of all chips at −1.
    base: f64,
}

impl<'a> Scorer<'a> {
    /// A chip of +1 counts its evidence times how far its symbol is from that of −1; shared chips count nothing.
    ///
    /// # Errors
    /// [`EngineError::Usage`] unless there is one number for each chip; when memory runs out or the device fails.
    pub fn new(device: &Device, issue: &'a Issue<'a>, evidence: &'a [f64]) -> Result<Self, EngineError> {
        let chance = issue.code().by_chance(evidence)?;
        let mut base = 0.0;
        let positions = issue.code().positions();
        let padded = positions.len().next_multiple_of(BLOCK_CHIPS).max(BLOCK_CHIPS);
        let mut term = |(position, c): (&Position, &f64)| match position {
            Position::OfCopy(bias) => {
                let [plus, minus] = bias.symbols();
                base += c * minus;
                (u32::from(bias.steps()), narrow(c * (plus - minus)))
            }
            Position::Shared(_) => (0, 0.0),
        };
        let (mut biases, mut weights): (Vec<u32>, Vec<f32>) = positions.iter().zip(evidence).map(&mut term).unzip();
        biases.resize(padded, 0);
        weights.resize(padded, 0.0);
        Ok(Self {
            device: device.clone(),
            issue,
            evidence,
            deviation: chance.deviation(),
            chance,
            base,
            biases: device.buffer_from("trace.biases", &biases)?,
            weights: device.buffer_from("trace.weights", &weights)?,
        })
    }

    /// The best of these copies, best first. All of them count as looked at.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn best(&self, copies: Range<u64>) -> Result<Vec<Scored>, EngineError> {
        let looked_at = copies.end.saturating_sub(copies.start);
        let mut best: Vec<(f32, u64)> = Vec::new();
        let mut first = copies.start;
        while first < copies.end {
            let numbers = first..copies.end.min(first + AT_ONCE);
            first = numbers.end;
            best.extend(self.scores(numbers.clone())?.into_iter().zip(numbers));
            best.sort_by(|a, b| b.0.total_cmp(&a.0));
            best.truncate(LOOKED_AT);
        }
        let in_full = |(_, copy): (f32, u64)| {
            let score = self.issue.code().score(self.evidence, &self.issue.copy_key(copy))?;
            let tail = self.chance.log_tail(score);
            let any = |log_p: f64| (log_p + (looked_at as f64).ln()).min(0.0);
            let [log_p_family, log_p_estimate] = [tail.bound, tail.estimate].map(any);
            Ok(Scored { copy, score: self.in_deviations(score), log_p_family, log_p_estimate })
        };
        let mut scored = best.into_par_iter().map(in_full).collect::<Result<Vec<_>, EngineError>>()?;
        scored.sort_by(|a, b| b.score.total_cmp(&a.score));
        Ok(scored)
    }

    /// What `count` copies that were never made score.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn decoys(&self, count: u64) -> Result<Decoys, EngineError> {
        Ok(Decoys::of(&self.decoy_scores(count)?))
    }

    /// The scores of `count` copies that were never made, in standard deviations.
    ///
    /// # Errors
    /// When memory runs out or the device fails.
    pub fn decoy_scores(&self, count: u64) -> Result<Vec<f64>, EngineError> {
        let scores = self.scores(DECOYS_FROM..DECOYS_FROM + count.min(AT_ONCE))?;
        Ok(scores.into_iter().map(|score| self.in_deviations(f64::from(score) + self.base)).collect())
    }

    /// A score in standard deviations of those by chance; 0 where all scores are 0, as of the original itself.
    #[must_use]
    pub fn in_deviations(&self, score: f64) -> f64 {
        if score == 0.0 { 0.0 } else { score / self.deviation }
    }

    /// Least score in deviations whose bound for one copy is at most `log_p`; `None` where no score has one so small.
    /// What is the original to the last bit shows no copy: there any score would do.
    #[must_use]
    pub fn required_score(&self, log_p: f64) -> Option<f64> {
        if self.deviation == 0.0 {
            return Some(0.0);
        }
        self.chance.required_score(log_p).map(|score| self.in_deviations(score))
    }

    fn scores(&self, copies: Range<u64>) -> Result<Vec<f32>, EngineError> {
        let keys: Vec<u32> = copies.flat_map(|copy| self.issue.copy_key(copy).words()).collect();
        let mut scores = self.device.buffer("trace.scores", keys.len() / KEY_WORDS)?;
        let keys = self.device.buffer_from("trace.keys", &keys)?;
        let chips = Chips { biases: &self.biases, weights: &self.weights };
        let mut rec = self.device.recorder()?;
        copy_score::sum(&mut rec, &keys, &chips, &mut scores)?;
        rec.submit()?;
        Ok(scores.read()?)
    }
}
