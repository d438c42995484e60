//! What an extractor says about one clip, aggregated over its frames.

use serde::Serialize;

use super::message::Message;
use crate::error::EngineError;

/// What an extractor says about one clip, aggregated over its frames.
///
/// Soft logits are averaged before any threshold. Frames share the extractor's bias, so they make one
/// reading with one p-value; per-frame p-values are never multiplied.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    mean_logits: Vec<f64>,
    frames: Vec<Message>,
}

impl Reading {
    /// Aggregates per-frame logits `[F, L]`, frames of all views one after the other.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] for a NaN or infinite logit; [`EngineError::Usage`] for no frames, a
    /// length that is no multiple of `num_bits`, or a `num_bits` that no message has.
    /// # Determinism
    /// Sums in f64 in frame order.
    pub fn from_logits(logits: &[f32], num_bits: u32) -> Result<Self, EngineError> {
        let row = num_bits as usize;
        if row == 0 || logits.is_empty() || !logits.len().is_multiple_of(row) {
            return Err(EngineError::Usage {
                what: "logits of a clip".to_owned(),
                got: format!("{} numbers", logits.len()),
                expected: format!("one or more frames of {num_bits} logits"),
            });
        }
        if let Some(at) = logits.iter().position(|o| !o.is_finite()) {
            return Err(EngineError::NotFinite {
                what: format!("logit of bit {} in frame {}", at % row, at / row),
                got: f64::from(logits[at]),
            });
        }
        let mut mean_logits = vec![0.0; row];
        let mut frames = Vec::with_capacity(logits.len() / row);
        for frame in logits.chunks_exact(row) {
            let bits: Vec<bool> = frame.iter().map(|&o| o > 0.0).collect();
            frames.push(Message::from_bits(&bits)?);
            for (mean, &logit) in mean_logits.iter_mut().zip(frame) {
                *mean += f64::from(logit);
            }
        }
        for mean in &mut mean_logits {
            *mean /= frames.len() as f64;
        }
        Ok(Self { mean_logits, frames })
    }

    /// Mean logit per bit `[L]`.
    #[must_use]
    pub fn mean_logits(&self) -> &[f64] {
        &self.mean_logits
    }

    /// Number of frames, `F`.
    #[must_use]
    pub fn num_frames(&self) -> u32 {
        u32::try_from(self.frames.len()).unwrap_or(u32::MAX)
    }

    /// The message read: bit = mean logit above 0.
    #[must_use]
    pub fn decoded(&self) -> Message {
        let bits: Vec<bool> = self.mean_logits.iter().map(|&o| o > 0.0).collect();
        Message::from_bits(&bits).expect("from_logits admits only lengths that messages have")
    }

    /// Number of bits that agree with `message`.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the lengths differ.
    pub fn matches(&self, message: &Message) -> Result<u32, EngineError> {
        Ok(message.num_bits() - self.decoded().hamming(message)?)
    }

    /// Mean, smallest and largest bit accuracy of single frames.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the lengths differ.
    pub fn frame_accuracy(&self, message: &Message) -> Result<Spread, EngineError> {
        let accuracies: Vec<f64> =
            self.frames.iter().map(|frame| message.bit_accuracy(frame)).collect::<Result<_, _>>()?;
        Ok(Spread::of(&accuracies))
    }

    /// Share of frames that agree with the majority, averaged over bits: 0.5 is noise, 1 a constant
    /// codeword. A clean clip near 1 shows an extractor that recites.
    #[must_use]
    pub fn bit_consistency(&self) -> f64 {
        let num_frames = self.frames.len() as f64;
        let num_bits = self.mean_logits.len();
        let mut ones = vec![0_u32; num_bits];
        for frame in &self.frames {
            for (count, bit) in ones.iter_mut().zip(frame.bits()) {
                *count += u32::from(bit);
            }
        }
        let share = |&count: &u32| {
            let share = f64::from(count) / num_frames;
            share.max(1.0 - share)
        };
        ones.iter().map(share).sum::<f64>() / num_bits as f64
    }

    /// Logits signed by the message `[L]`: positive where the bit is read as claimed.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if the lengths differ.
    pub fn margins(&self, message: &Message) -> Result<Vec<f64>, EngineError> {
        self.matches(message)?;
        let signed = |(bit, &o): (bool, &f64)| if bit { o } else { -o };
        Ok(message.bits().zip(&self.mean_logits).map(signed).collect())
    }
}

/// Mean and range of a list of figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Arithmetic mean.
    pub mean: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

impl Spread {
    pub(crate) fn of(values: &[f64]) -> Self {
        Self {
            mean: values.iter().sum::<f64>() / values.len() as f64,
            min: values.iter().copied().fold(f64::INFINITY, f64::min),
            max: values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        }
    }
}
