//! Choosing the rotation that a message is written through: each has a short try-out, and the one whose message is
//! learned best stays.
//!
//! How well a message goes into a scene through a rotation shows early: over twelve embeddings of one scene the bits
//! right after 25 steps and after 200 correlate by 0.8 (docs/log/2026-11-23.md, "Choosing among mixings").

use super::config::turns::TRY_OUT_STEPS;
use crate::base::prf::Prf;
use crate::watermark::extractor::calibration::Calibration;
use crate::watermark::extractor::rotation::KeyRotation;

/// Last steps of a try-out, whose losses are compared. All try-outs see the same clips.
const COMPARED: usize = 6;

/// Try-outs under way.
pub(super) struct RotationSearch {
    /// Rotations in all.
    of: u32,
    /// Rotation on trial, and the step that comes next.
    number: u32,
    step: usize,
    /// Sum of the compared losses so far.
    loss: f64,
    /// Least such sum of the rotations before, and which had it.
    best: Option<(f64, u32)>,
    /// The calibration of the first rotation, without a zero.
    first: Calibration,
    /// Features that a zero is the mean of, see [`super::fit::unmarked_features`].
    unmarked: Vec<f32>,
}

/// What comes after a step of a try-out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum AfterTry {
    /// The next step with the same rotation.
    Same,
    /// The next rotation, from nothing.
    Next,
    /// Training with this rotation, from nothing.
    Take(u32),
}

impl RotationSearch {
    pub(super) fn new(of: u32, first: Calibration, unmarked: Vec<f32>) -> Self {
        Self { of, number: 0, step: 0, loss: 0.0, best: None, first, unmarked }
    }

    /// Steps taken so far.
    pub(super) fn taken(&self) -> usize {
        self.number as usize * TRY_OUT_STEPS + self.step
    }

    /// Rotation on trial.
    pub(super) fn number(&self) -> u32 {
        self.number
    }

    /// Step of its try-out that comes next.
    pub(super) fn step(&self) -> usize {
        self.step
    }

    /// Features that a zero is the mean of.
    pub(super) fn unmarked(&self) -> &[f32] {
        &self.unmarked
    }

    /// One of the rotations, and the calibration turned by it, whose zero is still to be set.
    pub(super) fn rotated(&self, number: u32, prf: &Prf) -> (KeyRotation, Calibration) {
        let key_rotation = KeyRotation { number, of: self.of };
        let (mut from, mut to) = (KeyRotation::FIXED.stream(prf), key_rotation.stream(prf));
        (key_rotation, self.first.mixed_anew(&mut from, &mut to))
    }

    /// Takes in the message loss of a step.
    pub(super) fn note(&mut self, message_loss: f32) -> AfterTry {
        self.loss += if self.step + COMPARED < TRY_OUT_STEPS { 0.0 } else { f64::from(message_loss) };
        self.step += 1;
        if self.step < TRY_OUT_STEPS {
            return AfterTry::Same;
        }
        tracing::debug!(self.number, loss = self.loss / COMPARED as f64, "rotation tried");
        let best = self.best.filter(|(least, _)| self.loss >= *least).unwrap_or((self.loss, self.number));
        self.best = Some(best);
        (self.number, self.step, self.loss) = (self.number + 1, 0, 0.0);
        if self.number == self.of { AfterTry::Take(best.1) } else { AfterTry::Next }
    }
}
