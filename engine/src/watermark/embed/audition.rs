//! Choosing the mixing that a message is written through: each has a short try-out, and the one whose message is learned best stays.
//!
//! How well a message goes into a scene through a mixing shows early: over twelve embeddings of one scene the bits right after 25 steps and
//! after 200 correlate by 0.8 (docs/method.md, "Choosing among mixings").

use guard4d_kernels::KernelError;

use super::fit;
use super::step::{Stage, StepReport};
use super::{Embedding, critic_decoder};
use crate::error::EngineError;
use crate::train::schedule::cosine;
use crate::watermark::calibration::Calibration;
use crate::watermark::mixing::Mixing;

/// Steps of a try-out; the rates go down to their floor in them.
pub(super) const STEPS: usize = 12;
/// Last steps of a try-out, whose losses are compared. All try-outs see the same clips.
const COMPARED: usize = 6;

/// Try-outs under way.
pub(super) struct Audition {
    /// Mixing on trial, and the step that comes next.
    number: u32,
    step: usize,
    /// Sum of the compared losses so far.
    loss: f64,
    /// Least such sum of the mixings before, and which had it.
    best: Option<(f64, u32)>,
    /// The calibration of the first mixing, without a zero.
    first: Calibration,
    /// What its zero is the mean of, see [`fit::unmarked_features`].
    unmarked: Vec<f32>,
}

impl Audition {
    pub(super) fn new(first: Calibration, unmarked: Vec<f32>) -> Self {
        Self { number: 0, step: 0, loss: 0.0, best: None, first, unmarked }
    }

    /// Steps taken so far.
    pub(super) fn taken(&self) -> usize {
        self.number as usize * STEPS + self.step
    }
}

impl Embedding<'_> {
    /// The next step of the try-outs; after the last one the best mixing is taken, and training begins from nothing.
    pub(super) fn try_out(&mut self, mut audition: Audition) -> Result<StepReport, EngineError> {
        let Audition { number, step, .. } = audition;
        if step == 0 {
            self.take_mixing(&audition, number)?;
        }
        let report = self.advance(step, cosine(step, STEPS, self.active.lr_floor))?;
        audition.loss += if step + COMPARED < STEPS { 0.0 } else { f64::from(report.message) };
        audition.step += 1;
        if audition.step == STEPS {
            tracing::debug!(number, loss = audition.loss / COMPARED as f64, "mixing tried");
            if audition.best.is_none_or(|(least, _)| audition.loss < least) {
                audition.best = Some((audition.loss, number));
            }
            (audition.number, audition.step, audition.loss) = (number + 1, 0, 0.0);
            self.stage.forget_offsets()?;
            (self.mean_mse, self.keep) = (None, 1.0);
        }
        match audition.best {
            Some((_, best)) if audition.number == self.config.mixings => self.take_mixing(&audition, best)?,
            _ => self.audition = Some(audition),
        }
        Ok(StepReport { mixing: Some(number), ..report })
    }

    /// Reads through another of the key's mixings from now on.
    pub(super) fn take_mixing(&mut self, audition: &Audition, number: u32) -> Result<(), EngineError> {
        let (device, key) = (self.subject.device, self.subject.key);
        let mixing = Mixing { number, of: self.config.mixings };
        let prf = key.prf();
        let mut calibration = audition.first.mixed_anew(&mut Mixing::FIXED.stream(&prf), &mut mixing.stream(&prf));
        self.clips.with_room_beside_one(|| fit::set_zero(device, key, &mut calibration, &audition.unmarked))?;
        (self.weights.calibration, self.weights.mixing) = (calibration, mixing);
        self.critic.replace_decoder(critic_decoder(device, key, &self.weights)?);
        Ok(())
    }
}

impl Stage {
    /// Takes the mark out again, and with it what Adam knows of it.
    fn forget_offsets(&mut self) -> Result<(), KernelError> {
        let zeros = vec![0.0; self.offsets.len()];
        let state = &mut self.offsets_state;
        for buffer in [&mut self.offsets, &mut state.exp_avg, &mut state.exp_avg_sq] {
            buffer.write(&zeros)?;
        }
        state.steps = 0;
        Ok(())
    }
}
