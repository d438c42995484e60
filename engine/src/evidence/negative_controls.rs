//! All negative controls of one verification: readings that must *not* find the message. If one does, the extractor is
//! talking, not the asset, and "present" is forbidden.

use serde::Serialize;

use super::claim::Claim;
use super::control::{ChanceDeviation, Control, ControlKind, ControlResult, ControlState};
use super::message::Message;
use super::other_keys::{Bar, OtherKeysResult};
use super::reading::Reading;
use crate::error::EngineError;

/// All supplied readings of one kind together.
///
/// A single reading must be far from chance to fire once there are hundreds of them. A kind fires if at
/// least half of its readings lie outside a narrower band: by Markov's inequality chance does that with at
/// most twice the probability of one reading, however much the readings depend on one another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct KindResult {
    /// What was read.
    pub kind: ControlKind,
    /// Readings of this kind.
    pub num_readings: u32,
    /// Readings outside the band.
    pub num_outside: u32,
    /// Fires if at least half are.
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
    /// The same by kind.
    pub kinds: Vec<KindResult>,
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
        let (run, not_run): (Vec<_>, Vec<_>) =
            ControlKind::SUPPLIED.into_iter().partition(|&kind| controls.iter().any(|control| control.kind == kind));
        let kind_share = levels.control_level / 2.0 / f64::from(count(ControlKind::SUPPLIED.len()));
        let bar = Bar { claimed: reading.matches(message)?, num_bits: message.num_bits(), fpr: levels.fpr, share };
        Ok(Self {
            inverted: inverted(reading, message, share)?,
            other_messages: other_keys.in_reading(reading, &bar)?,
            other_readings: other_keys.in_own_readings(&bar)?,
            supplied: controls.iter().map(result).collect::<Result<_, EngineError>>()?,
            kinds: run.into_iter().map(|kind| KindResult::of(kind, controls, kind_share)).collect::<Result<_, _>>()?,
            not_run,
        })
    }

    /// Controls that fired, with their names.
    #[must_use]
    pub fn firing(&self) -> Vec<(ControlKind, String)> {
        let mut firing: Vec<_> = std::iter::once(&self.inverted)
            .chain(&self.supplied)
            .filter(|control| control.chance_deviation.state == ControlState::Fires)
            .map(|control| (control.kind, control.name.clone()))
            .collect();
        let others =
            [(ControlKind::OtherMessages, &self.other_messages), (ControlKind::OtherReadings, &self.other_readings)];
        for (kind, keys) in others.into_iter().filter(|(_, keys)| keys.state == ControlState::Fires) {
            firing.push((kind, format!("{} of {} other keys", keys.as_good, keys.num_keys)));
        }
        for kind in self.kinds.iter().filter(|kind| kind.state == ControlState::Fires) {
            firing.push((kind.kind, format!("{} of {}", kind.num_outside, kind.num_readings)));
        }
        firing
    }

    /// Number of supplied unrelated clips, and how many reach `matches`.
    #[must_use]
    pub fn unrelated_reaching(&self, matches: u32) -> (u32, u32) {
        let unrelated = || {
            let is_unrelated = |c: &&ControlResult| c.kind == ControlKind::UnrelatedClip;
            self.supplied.iter().filter(is_unrelated)
        };
        let reaching = unrelated().filter(|c| c.chance_deviation.matches >= matches).count();
        (count(unrelated().count()), count(reaching))
    }
}

impl KindResult {
    fn of(kind: ControlKind, controls: &[Control], share: f64) -> Result<Self, EngineError> {
        let (mut num_readings, mut num_outside) = (0, 0);
        for control in controls.iter().filter(|control| control.kind == kind) {
            num_readings += 1;
            num_outside += u32::from(control.chance_deviation(1.0 - share / 2.0)?.state == ControlState::Fires);
        }
        let state = if 2 * num_outside >= num_readings { ControlState::Fires } else { ControlState::Quiet };
        Ok(Self { kind, num_readings, num_outside, state })
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
