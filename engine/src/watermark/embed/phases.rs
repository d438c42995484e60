//! Going on in the schedule: from phase to phase with what was trained so far, and from rotation to rotation before.

use super::config::turns::TRY_OUT_STEPS;
use super::embedding::{Embedding, folded_decoder};
use super::fidelity_hold::FidelityHold;
use super::fit;
use super::progress::Verdict;
use super::report::{HeldOutEvaluation, HeldOutReport, PhaseReport, StepReport, StopReason};
use super::rotation_search::{AfterTry, RotationSearch};
use super::visibility;
use crate::base::schedule::cosine;
use crate::error::EngineError;
use crate::scene::gaussians::CHANNELS;

impl Embedding<'_> {
    /// Takes in what the held-out clips show after the step just taken: goes on, advances, or begins to settle.
    pub(super) fn note(&mut self, report: &HeldOutReport) -> Result<(), EngineError> {
        self.progress.evaluations.push(HeldOutEvaluation::new(self.step, report));
        let Some(schedule) = &self.config.schedule else { return Ok(()) };
        let verdict = match self.progress.is_evaluated(schedule, self.step) {
            true => self.progress.judge(schedule, self.config.fidelity.target_psnr, self.step, report),
            false => Verdict::Stay,
        };
        match verdict {
            Verdict::End(reason) => self.leave(reason, report),
            Verdict::Advance(reason) => {
                self.leave(reason, report);
                self.progress.phase += 1;
                self.take_phase()?;
            }
            Verdict::Stay if self.step >= self.config.optimiser.steps && self.progress.is_under_way() => {
                self.leave(StopReason::Steps, report);
            }
            Verdict::Stay => {}
        }
        Ok(())
    }

    /// Notes what the phase bought that ends now.
    fn leave(&mut self, stop_reason: StopReason, report: &HeldOutReport) {
        let offsets = &self.buffers.offsets;
        let share = self.active.fidelity.visibility_share;
        let splats = match &self.visibility {
            Some(visibility) => visibility::most_visible(visibility, share).into_iter().filter(|r| *r).count(),
            None => offsets.num_splats(),
        };
        let report = PhaseReport {
            splats,
            offsets: splats * offsets.coefficients() * CHANNELS,
            clips: self.active.views.clips,
            steps: 0,
            stop_reason,
            evaluation: HeldOutEvaluation::new(self.step, report),
        };
        self.progress.leave(self.step, report);
        tracing::debug!(phase = self.progress.phase, ?report, "phase over");
    }

    /// Makes ready what the phase trains that it is in.
    pub(super) fn take_phase(&mut self) -> Result<(), EngineError> {
        self.active = self.config.in_phase(self.progress.phase);
        let (clips, buffers) = (&mut self.clips, &mut self.buffers);
        let bases = self.active.fidelity.bases;
        let is_wider = bases != buffers.offsets.bases();
        if is_wider {
            // Frames are planned otherwise where all coefficients have offsets.
            clips.forget_clips();
            buffers.offsets.widen(bases)?;
        }
        let before = clips.training();
        clips.use_training(self.active.views.clips as usize);
        if let Some(visibility) = &self.visibility {
            let share = self.active.fidelity.visibility_share;
            let rates = clips.with_room(|| visibility::rates(&buffers.offsets, visibility, share))?;
            buffers.offsets.set_rates(rates);
        }
        if is_wider || clips.training() != before {
            clips.fill(buffers)?;
        }
        Ok(())
    }

    /// The next step of the try-outs; after the last one the best rotation is taken, and training begins from nothing.
    pub(super) fn try_rotation(&mut self, mut search: RotationSearch) -> Result<StepReport, EngineError> {
        let (number, step) = (search.number(), search.step());
        if step == 0 {
            self.take_rotation(&search, number)?;
        }
        let report = self.take_step(step, cosine(step, TRY_OUT_STEPS, self.active.optimiser.lr_floor))?;
        let after = search.note(report.message);
        if after != AfterTry::Same {
            self.buffers.offsets.forget()?;
            self.hold = FidelityHold::default();
        }
        match after {
            AfterTry::Take(best) => self.take_rotation(&search, best)?,
            AfterTry::Same | AfterTry::Next => self.search = Some(search),
        }
        Ok(StepReport { key_rotation: Some(number), ..report })
    }

    /// Reads through another of the key's rotations from now on.
    pub(super) fn take_rotation(&mut self, search: &RotationSearch, number: u32) -> Result<(), EngineError> {
        let (device, key) = (self.subject.device, self.subject.key);
        let (key_rotation, mut calibration) = search.rotated(number, &key.prf());
        self.clips.with_room_beside_one(|| fit::set_zero(device, key, &mut calibration, search.unmarked()))?;
        (self.weights.calibration, self.weights.key_rotation) = (calibration, key_rotation);
        self.loss.replace_decoder(folded_decoder(device, key, &self.weights)?);
        Ok(())
    }
}
