//! Which guess of what was done to the suspect clips brings them nearest to what is sought, and which id fits best
//! then.

use super::report::IdEvidence;
use super::sought::Promised;
use super::suspect::Suspects;
use crate::base::prf::Prf;
use crate::error::EngineError;
use crate::evidence::extractor_mode::ExtractorMode;
use crate::evidence::id_code::{IdReading, SearchedP};
use crate::evidence::message::Message;
use crate::evidence::reading::Reading;
use crate::evidence::thresholds::DecisionStatistic;

/// What the suspect clips say with one of the guesses undone.
pub(super) struct Answer {
    /// The guess's number.
    guess: usize,
    reading: Reading,
    /// What they are compared with.
    message: Message,
    /// The best id, and what it proves as the best of all.
    id: Option<(IdReading, SearchedP)>,
    /// As if nothing had been chosen; the least decides between guesses.
    p: SearchedP,
    /// Sum of the logits signed by the message, over the norm of the logits.
    clearness: f64,
}

/// The answer that comes nearest to what is sought, by the statistic that decides.
///
/// Where several leave no bit wrong: rather nothing than a guess, and of guesses the one of the clearest bits.
///
/// # Errors
/// [`EngineError::Usage`] without a frame, or for lengths that do not fit.
pub(super) fn nearest(
    suspects: &Suspects,
    num_bits: u32,
    promised: &Promised,
    prf: &Prf,
    statistic: DecisionStatistic,
) -> Result<Answer, EngineError> {
    let answers = suspects.features().iter().enumerate().map(|(guess, features)| {
        let reading = Reading::from_logits(&features.logits, num_bits)?;
        Answer::of(guess, reading, promised, prf)
    });
    let answers = answers.collect::<Result<Vec<_>, EngineError>>()?;
    let p = |answer: &Answer| answer.p.by(statistic);
    let nearest = answers.into_iter().min_by(|a, b| {
        let is_guess = |answer: &Answer| answer.guess > 0;
        let equals = || is_guess(a).cmp(&is_guess(b)).then(b.clearness.total_cmp(&a.clearness));
        p(a).total_cmp(&p(b)).then_with(equals)
    });
    Ok(nearest.expect("that nothing was done is always among the guesses"))
}

impl Answer {
    /// What a reading says with the guess of this number undone.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for lengths that do not fit.
    pub(super) fn of(guess: usize, reading: Reading, promised: &Promised, prf: &Prf) -> Result<Self, EngineError> {
        let (mut message, mut id) = (promised.message(), None);
        if let Some(promised) = promised.id() {
            let code = promised.code();
            let (found, p) = code.read(&reading, prf)?;
            if promised.is_any() {
                message = code.message(found.id, &code.pad(prf)?)?;
            }
            id = Some((found, p));
        }
        let p = SearchedP::of(&reading, &message, 1)?;
        let margins = reading.margins(&message)?;
        let clearness = margins.iter().sum::<f64>() / margins.iter().map(|m| m * m).sum::<f64>().sqrt();
        Ok(Self { guess, reading, message, id, p, clearness })
    }

    /// Number of the guess that was undone.
    pub(super) fn guess(&self) -> usize {
        self.guess
    }

    /// What all suspect clips say then.
    pub(super) fn reading(&self) -> &Reading {
        &self.reading
    }

    /// What they are compared with.
    pub(super) fn message(&self) -> Message {
        self.message
    }

    /// Claims that this one was chosen from, of which `chosen` were there before ids: rotations, times guesses.
    pub(super) fn searched(&self, promised: &Promised, chosen: u32) -> u32 {
        let ids = match (promised.id(), self.id) {
            (Some(promised), Some((_, p))) if promised.is_any() => p.searched,
            _ => 1,
        };
        chosen.saturating_mul(ids)
    }

    /// What the clips say about ids, if they are asked for one.
    pub(super) fn id_evidence(&self, promised: &Promised, chosen: u32, mode: ExtractorMode) -> Option<IdEvidence> {
        let (promised, (found, p)) = promised.id().zip(self.id)?;
        Some(IdEvidence {
            id_bits: promised.code().id_bits(),
            distance: promised.code().distance(),
            found,
            margin: found.margin(),
            promised: promised.number(),
            is_promised: found.id == promised.number(),
            p_value: mode.is_message_blind().then(|| p.among(chosen)),
        })
    }
}
