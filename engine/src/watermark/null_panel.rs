//! Null panel: readings that must *not* find the message. If one does, the extractor is talking, not the
//! asset, and "present" is forbidden.

use std::fmt;

use serde::Serialize;

use super::evidence::Claim;
use super::message::Message;
use super::other_keys::{Bar, OtherKeys};
use super::reading::Reading;
use super::statistics::chance_band;
use crate::EngineError;

/// What a control is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlKind {
    /// The owner's asset before embedding, rendered like the suspect clip.
    CleanRender,
    /// A clip that has nothing to do with the asset.
    UnrelatedClip,
    /// The suspect clip read with another trained key, for that key's message.
    OtherKey,
    /// The suspect clip against the inverted message.
    InvertedMessage,
    /// The suspect clip against the messages of throw-away keys.
    OtherMessages,
    /// The suspect clip's features read by the calibrations of throw-away keys, each for its own message.
    OtherReadings,
}

impl ControlKind {
    /// Controls that need input from the caller; the others are always run.
    pub const SUPPLIED: [Self; 3] = [Self::CleanRender, Self::UnrelatedClip, Self::OtherKey];
}

impl fmt::Display for ControlKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::CleanRender => "clean render",
            Self::UnrelatedClip => "unrelated clip",
            Self::OtherKey => "other key",
            Self::InvertedMessage => "inverted message",
            Self::OtherMessages => "other keys' messages",
            Self::OtherReadings => "other keys' readings",
        })
    }
}

/// A reading of something that should not hold the message.
#[derive(Clone, Debug)]
pub struct Control {
    /// What was read.
    pub kind: ControlKind,
    /// File or key, for the report.
    pub name: String,
    /// The extractor's answer.
    pub reading: Reading,
    /// The message it is compared with.
    pub message: Message,
}

/// Whether a control found what it must not find.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlState {
    /// Consistent with chance.
    Quiet,
    /// Outside the two-sided chance band.
    Fires,
}

/// Two-sided leak measure of one reading. Accuracy far *below* one half is as informative as above.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Leak {
    /// Matching bits.
    pub matches: u32,
    /// Bits compared.
    pub num_bits: u32,
    /// |accuracy − ½|.
    pub deviation: f64,
    /// Fewest matches inside the chance band.
    pub band_low: u32,
    /// Most matches inside the chance band.
    pub band_high: u32,
    /// Inside or outside.
    pub state: ControlState,
}

impl Leak {
    /// Share of the bits that match.
    #[must_use]
    pub fn share(&self) -> f64 {
        f64::from(self.matches) / f64::from(self.num_bits)
    }

    /// Compares a match count with the band that chance keeps to with probability `confidence`.
    ///
    /// # Errors
    /// [`EngineError::Usage`] unless `confidence` is in [0, 1).
    pub fn measure(matches: u32, num_bits: u32, confidence: f64) -> Result<Self, EngineError> {
        let band = chance_band(num_bits, confidence)?;
        let state = if band.contains(&matches) { ControlState::Quiet } else { ControlState::Fires };
        Ok(Self {
            matches,
            num_bits,
            deviation: (f64::from(matches) / f64::from(num_bits) - 0.5).abs(),
            band_low: *band.start(),
            band_high: *band.end(),
            state,
        })
    }
}

/// Outcome of one control.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ControlResult {
    /// What was read.
    pub kind: ControlKind,
    /// File or key.
    pub name: String,
    /// How far from chance it is.
    pub leak: Leak,
}

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
pub struct NullPanel {
    /// The suspect clip against the inverted message.
    pub inverted: ControlResult,
    /// What the owner's extractor reads, against the messages of throw-away keys.
    pub other_messages: OtherKeys,
    /// What the throw-away keys' own calibrations read, against the same messages.
    pub other_readings: OtherKeys,
    /// Controls the caller supplied.
    pub supplied: Vec<ControlResult>,
    /// The same by kind.
    pub kinds: Vec<KindResult>,
    /// Kinds of control that could have been supplied and were not.
    pub not_run: Vec<ControlKind>,
}

/// How strictly the panel is judged.
#[derive(Clone, Copy, Debug)]
pub struct PanelLevels {
    /// False-positive rate of the decision.
    pub fpr: f64,
    /// Probability that chance alone makes anything fire: one half shared by the single controls, the other
    /// by the kinds.
    pub control_level: f64,
}

impl NullPanel {
    /// Runs the panel for a claimed message.
    ///
    /// # Errors
    /// [`EngineError::Usage`] if message lengths do not fit the readings or the levels are not in (0, 1).
    pub fn run(claim: &Claim<'_>, levels: &PanelLevels) -> Result<Self, EngineError> {
        let Claim { message, reading, controls, throwaway, .. } = claim;
        // Inverted message, other keys' messages and other keys' readings are judged beside the supplied ones.
        let share = levels.control_level / 2.0 / f64::from(count(controls.len() + 3));
        let result = |control: &Control| {
            Ok(ControlResult { kind: control.kind, name: control.name.clone(), leak: control.leak(1.0 - share)? })
        };
        let (run, not_run): (Vec<_>, Vec<_>) =
            ControlKind::SUPPLIED.into_iter().partition(|&kind| controls.iter().any(|control| control.kind == kind));
        let kind_share = levels.control_level / 2.0 / f64::from(count(ControlKind::SUPPLIED.len()));
        let bar = Bar { claimed: reading.matches(message)?, num_bits: message.num_bits(), fpr: levels.fpr, share };
        Ok(Self {
            inverted: inverted(reading, message, share)?,
            other_messages: throwaway.in_reading(reading, &bar)?,
            other_readings: throwaway.in_own_readings(&bar)?,
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
            .filter(|control| control.leak.state == ControlState::Fires)
            .map(|control| (control.kind, control.name.clone()))
            .collect();
        let others =
            [(ControlKind::OtherMessages, &self.other_messages), (ControlKind::OtherReadings, &self.other_readings)];
        for (kind, keys) in others.into_iter().filter(|(_, keys)| keys.state == ControlState::Fires) {
            firing.push((kind, format!("{} of {} throw-away keys", keys.as_good, keys.num_keys)));
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
        let reaching = unrelated().filter(|c| c.leak.matches >= matches).count();
        (count(unrelated().count()), count(reaching))
    }
}

impl Control {
    fn leak(&self, confidence: f64) -> Result<Leak, EngineError> {
        Leak::measure(self.reading.matches(&self.message)?, self.message.num_bits(), confidence)
    }
}

impl KindResult {
    fn of(kind: ControlKind, controls: &[Control], share: f64) -> Result<Self, EngineError> {
        let (mut num_readings, mut num_outside) = (0, 0);
        for control in controls.iter().filter(|control| control.kind == kind) {
            num_readings += 1;
            num_outside += u32::from(control.leak(1.0 - share / 2.0)?.state == ControlState::Fires);
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
    let mut leak = Leak::measure(matches, inverted.num_bits(), 1.0 - share)?;
    if matches <= leak.band_high {
        leak.state = ControlState::Quiet;
    }
    Ok(ControlResult { kind: ControlKind::InvertedMessage, name: "suspect clip".to_owned(), leak })
}
