//! Which copies a film shows: all of them are scored on the device, and the best once more in full on the host.

use guard4d_kernels::code::copy_score::{self, BLOCK_CHIPS, Chips, KEY_WORDS};
use guard4d_kernels::{Buffer, Device};

use super::code::Bias;
use super::issue::Issue;
use crate::base::numbers::narrow;
use crate::error::EngineError;

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

/// Scores copies 0 to `copies` of an issue against `evidence`, a number for each chip. Returns the best, best first.
///
/// # Errors
/// [`EngineError::Usage`] unless there is one number for each chip; when memory runs out or the device fails.
pub fn best_copies(
    device: &Device,
    issue: &Issue<'_>,
    evidence: &[f64],
    copies: u64,
) -> Result<Vec<Scored>, EngineError> {
    let chance = issue.code().by_chance(evidence)?;
    let mut best: Vec<(f32, u64)> = Vec::new();
    let table = Table::new(device, issue, evidence)?;
    let mut first = 0;
    while first < copies {
        let numbers = first..copies.min(first + AT_ONCE);
        first = numbers.end;
        best.extend(table.scores(issue, numbers.clone())?.into_iter().zip(numbers));
        best.sort_by(|a, b| b.0.total_cmp(&a.0));
        best.truncate(LOOKED_AT);
    }
    let deviation = chance.deviation();
    let in_full = |(_, copy): (f32, u64)| {
        let score = issue.code().score(evidence, &issue.copy_key(copy))?;
        let tail = chance.log_tail(score);
        let any = |log_p: f64| (log_p + (copies as f64).ln()).min(0.0);
        let [log_p_family, log_p_estimate] = [tail.bound, tail.estimate].map(any);
        Ok(Scored { copy, score: score / deviation, log_p_family, log_p_estimate })
    };
    let mut scored = best.into_iter().map(in_full).collect::<Result<Vec<_>, EngineError>>()?;
    scored.sort_by(|a, b| b.score.total_cmp(&a.score));
    Ok(scored)
}

/// What all copies' chips are counted by, on the device.
struct Table {
    device: Device,
    biases: Buffer<u32>,
    weights: Buffer<f32>,
}

impl Table {
    /// A chip of +1 counts its evidence times how far its symbol is from that of −1; what all copies share is left out.
    fn new(device: &Device, issue: &Issue<'_>, evidence: &[f64]) -> Result<Self, EngineError> {
        let positions = issue.code().biases();
        let padded = positions.len().next_multiple_of(BLOCK_CHIPS).max(BLOCK_CHIPS);
        let mut biases: Vec<u32> = positions.iter().map(|bias| u32::from(bias.steps())).collect();
        let weight = |(bias, c): (&Bias, &f64)| {
            let [plus, minus] = bias.symbols();
            narrow(c * (plus - minus))
        };
        let mut weights: Vec<f32> = positions.iter().zip(evidence).map(weight).collect();
        biases.resize(padded, 0);
        weights.resize(padded, 0.0);
        Ok(Self {
            device: device.clone(),
            biases: device.buffer_from("trace.biases", &biases)?,
            weights: device.buffer_from("trace.weights", &weights)?,
        })
    }

    fn scores(&self, issue: &Issue<'_>, copies: std::ops::Range<u64>) -> Result<Vec<f32>, EngineError> {
        let keys: Vec<u32> = copies.flat_map(|copy| issue.copy_key(copy).words()).collect();
        let mut scores = self.device.buffer("trace.scores", keys.len() / KEY_WORDS)?;
        let keys = self.device.buffer_from("trace.keys", &keys)?;
        let chips = Chips { biases: &self.biases, weights: &self.weights };
        let mut rec = self.device.recorder()?;
        copy_score::sum(&mut rec, &keys, &chips, &mut scores)?;
        rec.submit()?;
        Ok(scores.read()?)
    }
}
