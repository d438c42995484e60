//! Bit by bit: what clips that carry no mark say of each bit of a message.
//!
//! The share of all bits hides a fixed word: whoever says half of the message's bits right, always the same ones, is at
//! one half. Bit by bit that word reads as zeros and ones.

use serde::Serialize;

use super::control::ControlState;
use super::message::Message;
use super::reading::Reading;
use super::statistics::chance_band;
use crate::error::EngineError;

/// Probability with which as many coin flips stay inside all bits' bands.
const CONFIDENCE: f64 = 0.99;

/// How often each bit of a message is read in some clips, against what chance gives.
///
/// Clips of one asset are alike, and the zero of each bit lies at their mean: coin flips are a measure, not a model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PerBit {
    /// Clips read.
    pub clips: u32,
    /// Clips in which a bit agrees with the message `[L]`.
    pub agreeing: Vec<u32>,
    /// Largest |share of clips that agree − ½| of a bit.
    pub max_deviation: f64,
    /// Bits that read the same in all clips.
    pub constant: u32,
    /// How many of as many coins would: L · 2^(1 − clips). A single clip has nothing but such bits.
    pub constant_by_chance: f64,
    /// Fewest clips inside the band that all bits' coins keep to with a probability of 99 %.
    pub band_low: u32,
    /// Most clips inside that band.
    pub band_high: u32,
    /// Fires if any bit lies outside the band.
    pub state: ControlState,
}

impl PerBit {
    /// Counts the bits of `message` in readings of clips, one each.
    ///
    /// # Errors
    /// [`EngineError::Usage`] when lengths differ, or without a reading.
    pub fn of(readings: &[Reading], message: &Message) -> Result<Self, EngineError> {
        if readings.is_empty() {
            return Err(EngineError::Usage {
                what: "readings".to_owned(),
                got: "none".to_owned(),
                expected: "at least one clip's".to_owned(),
            });
        }
        let bits = message.num_bits();
        let mut agreeing = vec![0_u32; bits as usize];
        for reading in readings {
            reading.matches(message)?;
            for (count, (read, written)) in agreeing.iter_mut().zip(reading.decoded().bits().zip(message.bits())) {
                *count += u32::from(read == written);
            }
        }
        let clips = u32::try_from(readings.len()).unwrap_or(u32::MAX);
        let deviation = |&count: &u32| (f64::from(count) / f64::from(clips) - 0.5).abs();
        let band = chance_band(clips, 1.0 - (1.0 - CONFIDENCE) / f64::from(bits))?;
        let constant = agreeing.iter().filter(|&&count| count == 0 || count == clips).count();
        let quiet = agreeing.iter().all(|count| band.contains(count));
        Ok(Self {
            clips,
            max_deviation: agreeing.iter().map(deviation).fold(0.0, f64::max),
            constant: u32::try_from(constant).unwrap_or(u32::MAX),
            constant_by_chance: f64::from(bits) * (1.0 - f64::from(clips)).exp2(),
            band_low: *band.start(),
            band_high: *band.end(),
            state: if quiet { ControlState::Quiet } else { ControlState::Fires },
            agreeing,
        })
    }
}
