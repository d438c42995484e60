//! How far training is in its schedule, and what an evaluation means for it.

use serde::{Deserialize, Serialize};

use super::config::{AdaptiveSchedule, Aim, EmbedConfig};
use super::report::{HeldOutEvaluation, HeldOutReport, PhaseReport, StopReason};
use crate::base::schedule::cosine;

/// Steps that are taken after the last phase while the rates fall to their floor, which settles the mark.
const SETTLING_STEPS: usize = 25;
/// Fidelity that may be missing when an evaluation finds the mark good enough, dB; the hold makes up for it while the
/// mark settles.
const PSNR_SLACK_DB: f32 = 0.25;
/// Fidelity that may be left over, dB, for an evaluation without progress to count: a mark that still grows is not
/// done.
const GROWN_DB: f32 = 0.5;
/// Share of the held-out frames' bits by which an evaluation must beat the best one before it to count as progress: one
/// standard error of a share of 0.95 among the 1024 bits of eight clips that read 16 is 0.007.
const GAIN: f32 = 0.007;

/// What to do after an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// More of the same.
    Stay,
    /// On to the next phase.
    Advance(StopReason),
    /// Settle, and end.
    End(StopReason),
}

/// Where an embedding is in its schedule.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Progress {
    /// Number of the phase.
    pub(super) phase: usize,
    /// Steps taken when it began.
    since: usize,
    /// Best share of bits so far.
    best: f32,
    /// Evaluations in this phase since there was progress.
    flat: u32,
    /// Steps taken when it was decided to end.
    decided_at: Option<usize>,
    /// All evaluations, also those of an embedding that takes all steps.
    pub(super) evaluations: Vec<HeldOutEvaluation>,
    /// The phases that are over.
    pub(super) phases: Vec<PhaseReport>,
}

impl Aim {
    fn is_met(&self, report: &HeldOutReport) -> bool {
        f64::from(report.proven) >= self.proven && f64::from(report.clip_accuracy) >= self.accuracy
    }
}

impl Progress {
    /// Takes in an evaluation after `step` steps.
    pub(super) fn judge(
        &mut self,
        schedule: &AdaptiveSchedule,
        target_psnr: f32,
        step: usize,
        report: &HeldOutReport,
    ) -> Verdict {
        if self.decided_at.is_some() {
            return Verdict::Stay;
        }
        let is_met = schedule.aim.is_met(report) && report.psnr >= target_psnr - PSNR_SLACK_DB;
        let has_gained = report.bit_accuracy >= self.best + GAIN;
        if has_gained {
            (self.best, self.flat) = (report.bit_accuracy, 0);
        } else if report.psnr <= target_psnr + GROWN_DB {
            self.flat += 1;
        }
        let is_last = schedule.is_last(self.phase);
        let reason = if is_met {
            StopReason::Enough
        } else if is_last && self.flat >= schedule.patience {
            StopReason::Flat
        } else if step >= self.end(schedule) {
            StopReason::Steps
        } else {
            return Verdict::Stay;
        };
        if reason == StopReason::Enough || is_last {
            self.decided_at = Some(step);
            return Verdict::End(reason);
        }
        Verdict::Advance(reason)
    }

    /// Steps taken when the phase ends for want of more.
    fn end(&self, schedule: &AdaptiveSchedule) -> usize {
        self.since + schedule.phases.get(self.phase).map_or(0, |phase| phase.steps)
    }

    /// Whether held-out clips are evaluated after `step` steps.
    pub(super) fn is_evaluated(&self, schedule: &AdaptiveSchedule, step: usize) -> bool {
        let on_the_way = schedule.is_last(self.phase) && (step - self.since).is_multiple_of(schedule.every);
        on_the_way || step == self.end(schedule)
    }

    /// Notes what the phase bought that ends after `step` steps.
    pub(super) fn leave(&mut self, step: usize, report: PhaseReport) {
        self.phases.push(PhaseReport { steps: step - self.since, ..report });
        // The mark settles from the rates that the last phase ended with.
        if self.decided_at.is_none() {
            (self.since, self.flat) = (step, 0);
        }
    }

    /// Whether the phase is still to be reported.
    pub(super) fn is_under_way(&self) -> bool {
        self.phases.len() <= self.phase
    }

    /// Steps in all. Where the rates are at their floor already, nothing has to settle.
    pub(super) fn steps(&self, config: &EmbedConfig) -> usize {
        let settling = match &config.schedule {
            Some(schedule) if !schedule.is_last(self.phase) => 0,
            _ => SETTLING_STEPS,
        };
        let steps = config.optimiser.steps;
        self.decided_at.map_or(steps, |at| steps.min(at + settling))
    }

    /// Share of the learning rates in step number `step`: a cosine over each phase's steps, or over all without a
    /// schedule.
    pub(super) fn decay(&self, config: &EmbedConfig, step: usize) -> f32 {
        let (steps, floor) = (config.optimiser.steps, config.optimiser.lr_floor);
        let end = config.schedule.as_ref().map_or(steps, |schedule| self.end(schedule).min(steps));
        let planned = |step: usize| cosine(step - self.since, end - self.since, floor);
        match self.decided_at {
            None => planned(step),
            Some(at) => planned(at) * cosine(step - at, SETTLING_STEPS, floor),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::extractor_mode::ExtractorMode;
    use crate::watermark::embed::config::{Phase, Profile};
    use guard4d_kernels::shape::OffsetBases;

    fn schedule() -> AdaptiveSchedule {
        let dc = Phase { bases: OffsetBases::Dc, visibility_share: 0.9, clips: 2, steps: 100 };
        let phases = vec![dc, Phase { visibility_share: 1.0, clips: 4, ..dc }];
        AdaptiveSchedule {
            phases,
            aim: Aim { p_value: 1e-3, proven: 0.75, accuracy: 0.75 },
            every: 10,
            patience: 2,
            held_out: 3,
        }
    }

    /// Its last phase alone.
    fn one_phase() -> AdaptiveSchedule {
        let schedule = schedule();
        AdaptiveSchedule { phases: schedule.phases[1..].to_vec(), ..schedule }
    }

    /// Verdicts on evaluations, and the steps after which they are taken; shares of bits right and of clips that prove
    /// it, PSNR. Advances as told to.
    fn verdicts(schedule: &AdaptiveSchedule, evaluations: &[(f32, f32, f32)]) -> Vec<(usize, Verdict)> {
        let mut progress = Progress::default();
        let mut evaluations = evaluations.iter();
        let mut judge = |step: usize| {
            let &(bit_accuracy, proven, psnr) =
                progress.is_evaluated(schedule, step).then(|| evaluations.next()).flatten()?;
            let report = HeldOutReport { bit_accuracy, clip_accuracy: bit_accuracy, proven, psnr };
            let verdict = progress.judge(schedule, 40.0, step, &report);
            if let Verdict::Advance(reason) | Verdict::End(reason) = verdict {
                let evaluation = HeldOutEvaluation::new(step, &report);
                progress.leave(
                    step,
                    PhaseReport { splats: 1, offsets: 3, clips: 2, steps: 0, stop_reason: reason, evaluation },
                );
                progress.phase += usize::from(verdict == Verdict::Advance(reason));
            }
            Some((step, verdict))
        };
        (1..=200).filter_map(&mut judge).collect()
    }

    #[test]
    fn an_evaluation_ends_every_phase_and_the_last_one_has_some_on_the_way() {
        use Verdict::{Advance, End, Stay};
        let low = (0.6, 0.5, 40.4);
        let all = verdicts(&schedule(), &[low; 9]);
        // The evaluation at the end of the first phase is the best so far.
        assert_eq!(all[..3], [(100, Advance(StopReason::Steps)), (110, Stay), (120, End(StopReason::Flat))], "{all:?}");
        let enough = verdicts(&schedule(), &[(0.9, 1.0, 40.4)]);
        assert_eq!(enough, [(100, End(StopReason::Enough))], "the first phase will do");
    }

    #[test]
    fn what_brings_no_progress_in_the_last_phase_ends_it() {
        use Verdict::{End, Stay};
        let low = |accuracy: f32| (accuracy, 0.5, 40.4);
        let flat = verdicts(&one_phase(), &[low(0.6), low(0.603), low(0.61), low(0.61), low(0.61), low(0.99)]);
        // 0.61 is progress by more than one standard error; what comes after the end decides nothing.
        let expected = [Stay, Stay, Stay, Stay, End(StopReason::Flat), Stay];
        assert_eq!(flat.iter().map(|(_, verdict)| *verdict).collect::<Vec<_>>(), expected, "{flat:?}");
        let rising: Vec<_> = (0..20).map(|i| low(0.5 + 0.02 * i as f32)).collect();
        let steps = verdicts(&one_phase(), &rising);
        assert_eq!(steps[9], (100, End(StopReason::Steps)), "{steps:?}");
        assert!(steps.iter().enumerate().all(|(i, (_, v))| *v == Stay || i == 9), "{steps:?}");
    }

    #[test]
    fn rates_go_down_once_in_every_phase_and_settle_from_where_the_last_was_left() {
        let config = EmbedConfig::new(Profile::Draft, ExtractorMode::Blind).with(|config| {
            config.optimiser.steps = 150;
            config.schedule = Some(schedule());
        });
        let mut progress = Progress::default();
        let decay = |progress: &Progress, step: usize| progress.decay(&config, step);
        assert_eq!(decay(&progress, 0), 1.0, "at first");
        let floor = config.optimiser.lr_floor;
        assert!((decay(&progress, 100) - floor).abs() < 1e-6, "after the first phase: {}", decay(&progress, 100));
        (progress.phase, progress.since) = (1, 100);
        assert_eq!(decay(&progress, 100), 1.0, "at the start of the second");
        assert!((decay(&progress, 150) - floor).abs() < 1e-6, "steps end before the phase does");
        assert_eq!(progress.steps(&config), 150, "all");
        let before = decay(&progress, 120);
        progress.decided_at = Some(120);
        assert_eq!((decay(&progress, 120), progress.steps(&config)), (before, 120 + SETTLING_STEPS), "no jump");
        (progress.phase, progress.since, progress.decided_at) = (0, 0, Some(100));
        assert_eq!(progress.steps(&config), 100, "nothing has to settle");
    }

    #[test]
    fn an_evaluation_at_which_enough_clips_prove_it_ends_it() {
        use Verdict::{End, Stay};
        let end = End(StopReason::Enough);
        let said = |evaluations: &[(f32, f32, f32)]| {
            verdicts(&one_phase(), evaluations).iter().map(|(_, v)| *v).collect::<Vec<_>>()
        };
        assert_eq!(said(&[(0.9, 0.74, 41.0), (0.9, 0.75, 41.0), (0.9, 1.0, 41.0)]), [Stay, end, Stay], "once");
        assert_eq!(said(&[(0.9, 1.0, 39.75)]), [end], "within the slack");
        assert_eq!(said(&[(0.75, 1.0, 44.0)]), [end], "the least share of bits");
        assert_eq!(said(&[(0.74, 1.0, 41.0); 3]), [Stay; 3], "too few bits");
        let flat = End(StopReason::Flat);
        assert_eq!(said(&[(0.9, 1.0, 39.0), (0.9, 1.0, 39.0), (0.9, 1.0, 39.0)]), [Stay, Stay, flat], "too loud");
        let faint = said(&[(0.6, 0.5, 45.0); 9]);
        assert_eq!(faint, [Stay; 9], "a mark that still grows is not done");
        let none = f32::NAN;
        assert_eq!(said(&[(none, none, none); 3]), [Stay; 3], "what is no number decides nothing");
    }
}
