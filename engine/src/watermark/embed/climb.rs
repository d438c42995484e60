//! Going from one rung of the ladder to the next, with what was trained so far.

use guard4d_kernels::Device;
use guard4d_kernels::loss::sum::SumScratch;
use guard4d_kernels::optim::adam::AdamState;

use super::ladder::{Left, Look, RungReport, Verdict};
use super::step::{HeldOutReport, Stage};
use super::{Embedding, visibility};
use crate::error::EngineError;
use crate::render::OffsetBases;
use crate::scene::gaussians::CHANNELS;

impl Embedding<'_> {
    /// Takes in what the held-out clips show after the step just taken: goes on, climbs, or begins to settle.
    pub(super) fn look(&mut self, report: &HeldOutReport) -> Result<(), EngineError> {
        self.standing.looks.push(Look::new(self.step, report));
        let Some(ladder) = &self.config.ladder else { return Ok(()) };
        let verdict = match self.standing.is_look(ladder, self.step) {
            true => self.standing.judge(ladder, self.config.target_psnr, self.step, report),
            false => Verdict::Stay,
        };
        match verdict {
            Verdict::End(left) => self.leave(left, report),
            Verdict::Climb(left) => {
                self.leave(left, report);
                self.standing.rung += 1;
                self.take_rung()?;
            }
            Verdict::Stay if self.step >= self.config.steps && self.standing.is_under_way() => {
                self.leave(Left::Steps, report);
            }
            Verdict::Stay => {}
        }
        Ok(())
    }

    /// Notes what the rung bought that is left now.
    fn leave(&mut self, left: Left, report: &HeldOutReport) {
        let splats = match &self.light {
            Some(light) => visibility::within_reach(light, self.active.reach).into_iter().filter(|r| *r).count(),
            None => self.stage.num_splats,
        };
        let coefficients = match self.stage.bases {
            OffsetBases::Dc => 1,
            OffsetBases::All => (self.stage.sh_degree as usize + 1).pow(2),
        };
        let report = RungReport {
            splats,
            offsets: splats * coefficients * CHANNELS,
            views: self.active.views,
            steps: 0,
            left,
            look: Look::new(self.step, report),
        };
        self.standing.leave(self.step, report);
        tracing::debug!(rung = self.standing.rung, ?report, "rung left");
    }

    /// Makes ready what the rung trains that it stands on.
    pub(super) fn take_rung(&mut self) -> Result<(), EngineError> {
        let device = self.subject.device;
        self.active = self.config.on_rung(self.standing.rung);
        let (clips, stage) = (&mut self.clips, &mut self.stage);
        let is_wider = self.active.bases != stage.bases;
        if is_wider {
            // Frames are planned otherwise where all coefficients have offsets.
            clips.forget_clips();
            stage.widen(device, self.active.bases)?;
        }
        let before = clips.training();
        clips.use_training(self.active.views as usize);
        if let Some(light) = &self.light {
            let rates = || visibility::rates(device, (light, stage), self.active.reach);
            stage.offsets_state.rates = clips.with_room(rates)?;
        }
        if is_wider || clips.training() != before {
            clips.fill(stage)?;
        }
        Ok(())
    }
}

impl Stage {
    /// Gives offsets to more coefficients; those that are there keep their values and moments.
    fn widen(&mut self, device: &Device, bases: OffsetBases) -> Result<(), EngineError> {
        let (from, to) = (self.bases.floats(), bases.floats());
        let wider = |name: &str, values: Vec<f32>| {
            let mut rows = vec![0.0; self.num_splats * to];
            for (row, before) in rows.chunks_exact_mut(to).zip(values.chunks_exact(from)) {
                row[..CHANNELS].copy_from_slice(&before[..CHANNELS]);
            }
            device.buffer_from(name, &rows)
        };
        let offsets = wider("offsets", self.offsets.read()?)?;
        let state = AdamState {
            exp_avg: wider("offsets.exp_avg", self.offsets_state.exp_avg.read()?)?,
            exp_avg_sq: wider("offsets.exp_avg_sq", self.offsets_state.exp_avg_sq.read()?)?,
            steps: self.offsets_state.steps,
            rates: None,
        };
        let len = offsets.len();
        (self.v_offsets, self.penalty_sums) =
            (device.buffer("v_offsets", len)?, SumScratch::new(device, len.div_ceil(4))?);
        (self.offsets, self.offsets_state, self.bases) = (offsets, state, bases);
        Ok(())
    }
}
