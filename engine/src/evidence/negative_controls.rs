//! All negative controls of one verification: readings that must *not* find the message. If one does, the extractor is
//! talking, not the asset, and "present" is forbidden.

use std::fmt;

use serde::Serialize;

use super::claim::Claim;
use super::control::{ChanceDeviation, Control, ControlKind, ControlResult, ControlState};
use super::message::Message;
use super::other_keys::{Bar, OtherKeysResult};
use super::reading::Reading;
use super::statistics::{SoftScoreNull, binomial_tail};
use crate::error::EngineError;

/// Which readings are judged together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Pool {
    /// Clean renders of the original.
    CleanRenders,
    /// All films without a mark: clean renders, unrelated clips, and the program's own.
    UnmarkedFilms,
    /// Other keys, each for its own message.
    OtherKeys,
}

impl Pool {
    const ALL: [Self; 3] = [Self::CleanRenders, Self::UnmarkedFilms, Self::OtherKeys];

    fn holds(self, kind: ControlKind) -> bool {
        match self {
            Self::CleanRenders => kind == ControlKind::CleanRender,
            Self::UnmarkedFilms => kind.is_unmarked_film(),
            Self::OtherKeys => kind == ControlKind::OtherKey,
        }
    }
}

impl fmt::Display for Pool {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::CleanRenders => "all clean renders",
            Self::UnmarkedFilms => "all films without a mark",
            Self::OtherKeys => "all other keys",
        })
    }
}

/// Readings that are judged together: what hides in each of them adds up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PooledResult {
    /// What was read.
    pub pool: Pool,
    /// Readings in it.
    pub num_readings: u32,
    /// Matching bits of all of them.
    pub matches: u32,
    /// Bits compared in all of them.
    pub num_bits: u32,
    /// Chance of being so far from one half, on either side; exact.
    pub p_value: f64,
    /// Fires below the share of the control level that it has.
    pub state: ControlState,
}

/// All controls of one verification.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NegativeControls {
    /// The suspect clip against the inverted message.
    pub inverted: ControlResult,
    /// What the owner's extractor reads, against the messages of other keys.
    pub other_messages: OtherKeysResult,
    /// What those keys' own calibrations read, against the same messages.
    pub other_readings: OtherKeysResult,
    /// Controls the caller supplied.
    pub supplied: Vec<ControlResult>,
    /// The supplied ones and the program's own, taken together.
    pub pools: Vec<PooledResult>,
    /// Kinds of control that could have been supplied and were not.
    pub not_run: Vec<ControlKind>,
}

/// How strictly the controls are judged.
#[derive(Clone, Copy, Debug)]
pub struct PanelLevels {
    /// False-positive rate of the decision.
    pub fpr: f64,
    /// Probability that chance alone makes anything fire: one half shared by the single controls, the other
    /// by the kinds.
    pub control_level: f64,
}

impl NegativeControls {
    /// Judges the controls for a claimed message.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if message lengths do not fit the readings or the levels are not in (0, 1).
    pub fn run(claim: &Claim<'_>, levels: &PanelLevels) -> Result<Self, EngineError> {
        let Claim { message, reading, controls, other_keys, .. } = claim;
        // Inverted message, other keys' messages and other keys' readings are judged beside the supplied ones.
        let share = levels.control_level / 2.0 / f64::from(count(controls.len() + 3));
        let result = |control: &Control| {
            Ok(ControlResult {
                kind: control.kind,
                name: control.name.clone(),
                chance_deviation: control.chance_deviation(1.0 - share)?,
            })
        };
        let is_missing = |kind: &ControlKind| controls.iter().all(|control| control.kind != *kind);
        let pool_share = levels.control_level / 2.0 / f64::from(count(Pool::ALL.len()));
        let bar = Bar { claimed: reading.matches(message)?, num_bits: message.num_bits(), fpr: levels.fpr, share };
        Ok(Self {
            inverted: inverted(reading, message, share)?,
            other_messages: other_keys.in_reading(reading, &bar)?,
            other_readings: other_keys.in_own_readings(&bar)?,
            supplied: controls.iter().map(result).collect::<Result<_, EngineError>>()?,
            pools: Pool::ALL
                .into_iter()
                .filter_map(|pool| PooledResult::of(pool, controls, pool_share).transpose())
                .collect::<Result<_, _>>()?,
            not_run: ControlKind::SUPPLIED.into_iter().filter(is_missing).collect(),
        })
    }

    /// Controls that fired, with their names.
    #[must_use]
    pub fn firing(&self) -> Vec<Firing> {
        let mut firing: Vec<_> = std::iter::once(&self.inverted)
            .chain(&self.supplied)
            .filter(|control| control.chance_deviation.state == ControlState::Fires)
            .map(|control| Firing { what: control.kind.to_string(), name: control.name.clone() })
            .collect();
        let others =
            [(ControlKind::OtherMessages, &self.other_messages), (ControlKind::OtherReadings, &self.other_readings)];
        for (kind, keys) in others.into_iter().filter(|(_, keys)| keys.state == ControlState::Fires) {
            let name = format!("{} of {} other keys", keys.as_good, keys.num_keys);
            firing.push(Firing { what: kind.to_string(), name });
        }
        for pool in self.pools.iter().filter(|pool| pool.state == ControlState::Fires) {
            let PooledResult { matches, num_bits, p_value, .. } = pool;
            let name = format!("{matches} of {num_bits} bits, p = {p_value:.1e}");
            firing.push(Firing { what: pool.pool.to_string(), name });
        }
        firing
    }

    /// Number of unrelated clips, the program's own among them, and how many reach `matches`.
    #[must_use]
    pub fn unrelated_reaching(&self, matches: u32) -> (u32, u32) {
        let unrelated = || {
            let is_unrelated = |c: &&ControlResult| matches!(c.kind, ControlKind::UnrelatedClip | ControlKind::OwnClip);
            self.supplied.iter().filter(is_unrelated)
        };
        let reaching = unrelated().filter(|c| c.chance_deviation.matches >= matches).count();
        (count(unrelated().count()), count(reaching))
    }
}

/// A control that found what it must not find.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Firing {
    /// Which control.
    pub what: String,
    /// Film or key, or how many.
    pub name: String,
}

impl PooledResult {
    /// What the readings of a pool say together; none if it has none.
    ///
    /// Films are all compared with one message. However alike one reader reads them, the message was drawn without
    /// them: given all readings, it is the only thing left to chance. So each bit has as many votes as readings say 1
    /// more often than 0, and the sum of the votes that agree with the message has an exact distribution. Other keys
    /// have messages of their own, and their matches simply add up.
    fn of(pool: Pool, controls: &[Control], share: f64) -> Result<Option<Self>, EngineError> {
        let held: Vec<&Control> = controls.iter().filter(|control| pool.holds(control.kind)).collect();
        let Some(message) = held.first().map(|control| control.message) else { return Ok(None) };
        let (mut matches, mut num_bits) = (0, 0);
        let mut votes = vec![0.0; message.num_bits() as usize];
        for control in &held {
            matches += control.reading.matches(&control.message)?;
            num_bits += control.message.num_bits();
            votes
                .iter_mut()
                .zip(control.reading.decoded().bits())
                .for_each(|(v, bit)| *v += if bit { 1.0 } else { -1.0 });
        }
        let [above, below] = match pool {
            Pool::OtherKeys => [matches, num_bits - matches].map(|count| binomial_tail(count, num_bits, 0.5)),
            Pool::CleanRenders | Pool::UnmarkedFilms => {
                let null = SoftScoreNull::new(&votes)?;
                [null.p_value(&message)?, null.p_value(&message.inverted())?]
            }
        };
        let p_value = (2.0 * above.min(below)).min(1.0);
        let state = if p_value < share { ControlState::Fires } else { ControlState::Quiet };
        Ok(Some(Self { pool, num_readings: count(held.len()), matches, num_bits, p_value, state }))
    }
}

fn count(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

/// One-sided: the inverted message fires only if the clip says the *opposite* of the claim; that it is
/// badly matched by a marked clip is as it should be.
fn inverted(reading: &Reading, message: &Message, share: f64) -> Result<ControlResult, EngineError> {
    let inverted = message.inverted();
    let matches = reading.matches(&inverted)?;
    let mut chance_deviation = ChanceDeviation::measure(matches, inverted.num_bits(), 1.0 - share)?;
    if matches <= chance_deviation.band_high {
        chance_deviation.state = ControlState::Quiet;
    }
    Ok(ControlResult { kind: ControlKind::InvertedMessage, name: "suspect clip".to_owned(), chance_deviation })
}
