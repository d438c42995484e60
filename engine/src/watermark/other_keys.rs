//! Keys that nobody owns: how well a stranger's claim to the suspect clip would do.
//!
//! Their master secrets follow from the owner's, so that a report can be repeated. A throw-away key has what costs no
//! training: its message, and the rotation by which its calibration would mix the directions. It reads by the signs of
//! the mixed coordinates, which its token table and decoder would be trained to give back as bits.

use serde::Serialize;

use super::calibration::remix;
use super::message::{Message, Payload};
use super::null_panel::ControlState;
use super::prf::{MasterSecret, Prf, Purpose};
use super::reading::Reading;
use super::statistics::{binomial_tail, empirical_fpr_bound, match_p_value, required_matches};
use crate::EngineError;

/// Throw-away keys tried against every clip.
pub const NUM_OTHER_KEYS: u32 = 1000;

/// How the throw-away keys' claims did beside the owner's.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OtherKeys {
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

/// The owner's claim, which the strangers' are measured by.
#[derive(Clone, Copy, Debug)]
pub(super) struct OwnClaim<'a> {
    /// What the owner's extractor reads.
    pub(super) reading: &'a Reading,
    /// Mean calibrated coordinates of the suspect clip `[L]`.
    pub(super) coordinates: &'a [f64],
    /// The owner's message.
    pub(super) message: &'a Message,
    /// The owner's key.
    pub(super) prf: &'a Prf,
}

/// Tries every throw-away key's message twice: on what the owner's extractor reads, and on what the key's own
/// calibration makes of the same features.
///
/// # Errors
/// [`EngineError::Usage`] if lengths differ; [`EngineError::NotFinite`] for coordinates that are no numbers.
/// # Determinism
/// The same keys on every platform, rotations up to the last bits of the mathematical library.
pub(super) fn run(claim: &OwnClaim<'_>, fpr: f64, share: f64) -> Result<[OtherKeys; 2], EngineError> {
    let OwnClaim { reading, coordinates, message, prf } = *claim;
    let num_bits = message.num_bits();
    if coordinates.len() != num_bits as usize {
        return Err(EngineError::Usage {
            what: "calibrated coordinates".to_owned(),
            got: coordinates.len().to_string(),
            expected: format!("{num_bits}, one per bit"),
        });
    }
    if let Some(got) = coordinates.iter().copied().find(|z| !z.is_finite()) {
        return Err(EngineError::NotFinite { what: "calibrated coordinate".to_owned(), got });
    }
    let (mut as_read, mut as_mixed) = (Vec::new(), Vec::new());
    for index in 0..NUM_OTHER_KEYS {
        let stranger = stranger(prf, index);
        let own = Payload::Random(num_bits).message(&stranger)?;
        as_read.push(reading.matches(&own)?);
        let mixed = remix(coordinates, &mut stranger.stream(Purpose::Calibration, 0));
        let bits: Vec<bool> = mixed.iter().map(|&z| z > 0.0).collect();
        as_mixed.push(num_bits - own.hamming(&Message::from_bits(&bits)?)?);
    }
    let claimed = reading.matches(message)?;
    Ok([as_read, as_mixed].map(|matches| OtherKeys::count(&matches, (claimed, num_bits), fpr, share)))
}

/// A key that is made for one trial and forgotten.
fn stranger(owner: &Prf, index: u32) -> Prf {
    let secret = owner.mac(Purpose::OtherKeys, &index.to_le_bytes());
    Prf::new(&MasterSecret::from_bytes(*secret.as_bytes()))
}

impl OtherKeys {
    fn count(matches: &[u32], (claimed, num_bits): (u32, u32), fpr: f64, share: f64) -> Self {
        let needed = required_matches(num_bits, fpr);
        let reaching = |least: u32| {
            let count = matches.iter().filter(|&&m| m >= least).count();
            u32::try_from(count).expect("at most as many as keys were tried")
        };
        let (as_good, false_positives) = (reaching(claimed), needed.map_or(0, reaching));
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
