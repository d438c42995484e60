//! Other keys: how well somebody else's claim to the suspect clip would do.
//!
//! They are throwaways: nobody owns them, and their master secrets follow from the owner's, so that a report can be
//! repeated. Such a key has what costs no training: its message, and the rotation by which its calibration would mix
//! the directions. It reads by the signs of the mixed coordinates, which its token table and decoder would be trained
//! to give back as bits.

use serde::Serialize;

use super::control::ControlState;
use super::message::Message;
use super::payload::Payload;
use super::reading::Reading;
use super::statistics::{binomial_tail, empirical_fpr_bound, match_p_value, required_matches};
use crate::base::prf::{Prf, Purpose};
use crate::base::rotation::remix;
use crate::error::EngineError;

/// Other keys tried against every clip.
pub const NUM_OTHER_KEYS: u32 = 1000;

/// Other keys, derived from the owner's, and what they make of one clip.
#[derive(Clone, Debug)]
pub struct OtherKeys {
    /// Each key's message.
    messages: Vec<Message>,
    /// What each key's calibration reads.
    readings: Vec<Message>,
}

/// How the other keys' claims did beside the owner's.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OtherKeysResult {
    /// Keys tried.
    pub num_keys: u32,
    /// Most matches that any of them reached.
    pub most_matches: u32,
    /// How many matched at least as well as the claimed message.
    pub as_good: u32,
    /// (1 + `as_good`) / (1 + `num_keys`): rank of the claimed message.
    pub rank_p_value: f64,
    /// How many reached the threshold of the decision.
    pub false_positives: u32,
    /// (1 + `false_positives`) / (1 + `num_keys`).
    pub fpr_bound: f64,
    /// Fires if more of them match as well as the exact p-value allows.
    pub state: ControlState,
}

impl OtherKeys {
    /// Derives other keys from the owner's, and lets each read a clip by its mean coordinates `[L]` along the owner's
    /// calibrated directions, which are 0 where unmarked clips have their mean.
    ///
    /// # Errors
    /// [`EngineError::NotFinite`] for coordinates that are no numbers; [`EngineError::Usage`] for a length that no
    /// message has.
    /// # Determinism
    /// The same keys on every platform, rotations up to the last bits of the mathematical library.
    pub fn derive(owner: &Prf, coordinates: &[f64]) -> Result<Self, EngineError> {
        if let Some(got) = coordinates.iter().copied().find(|z| !z.is_finite()) {
            return Err(EngineError::NotFinite { what: "calibrated coordinate".to_owned(), got });
        }
        let num_bits = u32::try_from(coordinates.len()).unwrap_or(u32::MAX);
        let (mut messages, mut readings) = (Vec::new(), Vec::new());
        for index in 0..NUM_OTHER_KEYS {
            let prf = Prf::new(&owner.secret(Purpose::OtherKeys, &index.to_le_bytes()));
            messages.push(Payload::Random(num_bits).message(&prf)?);
            let mixed = remix(coordinates, &mut prf.stream(Purpose::Calibration, 0));
            readings.push(Message::from_bits(&mixed.iter().map(|&z| z > 0.0).collect::<Vec<_>>())?);
        }
        Ok(Self { messages, readings })
    }

    /// Compares every key's message with what the owner's extractor reads.
    pub(super) fn in_reading(&self, reading: &Reading, bar: &Bar) -> Result<OtherKeysResult, EngineError> {
        let matches = self.messages.iter().map(|own| reading.matches(own)).collect::<Result<Vec<_>, _>>()?;
        Ok(OtherKeysResult::count(&matches, bar))
    }

    /// Compares every key's message with what its own calibration reads.
    pub(super) fn in_own_readings(&self, bar: &Bar) -> Result<OtherKeysResult, EngineError> {
        let pairs = self.messages.iter().zip(&self.readings);
        let matches = pairs.map(|(own, read)| Ok(own.num_bits() - own.hamming(read)?));
        Ok(OtherKeysResult::count(&matches.collect::<Result<Vec<_>, EngineError>>()?, bar))
    }
}

/// What the other keys are measured by.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bar {
    /// Matches of the claimed message.
    pub(super) claimed: u32,
    /// Its bits.
    pub(super) num_bits: u32,
    /// False-positive rate of the decision.
    pub(super) fpr: f64,
    /// Probability at which chance may make a control fire.
    pub(super) share: f64,
}

impl OtherKeysResult {
    fn count(matches: &[u32], bar: &Bar) -> Self {
        let Bar { claimed, num_bits, fpr, share } = *bar;
        let reaching = |least: u32| {
            let count = matches.iter().filter(|&&m| m >= least).count();
            u32::try_from(count).expect("at most as many as keys were tried")
        };
        let (as_good, false_positives) = (reaching(claimed), required_matches(num_bits, fpr).map_or(0, reaching));
        let expected_rate = match_p_value(claimed, num_bits);
        let state = if binomial_tail(as_good, NUM_OTHER_KEYS, expected_rate) < share {
            ControlState::Fires
        } else {
            ControlState::Quiet
        };
        Self {
            num_keys: NUM_OTHER_KEYS,
            most_matches: matches.iter().copied().max().unwrap_or(0),
            as_good,
            rank_p_value: empirical_fpr_bound(as_good, NUM_OTHER_KEYS),
            false_positives,
            fpr_bound: empirical_fpr_bound(false_positives, NUM_OTHER_KEYS),
            state,
        }
    }
}
