//! No more than a scene needs: starting with little, adding more where held-out clips ask for it, and ending in time.

use guard4d_kernels::shape::OffsetBases;
use serde::{Deserialize, Serialize};

use super::bases;
use crate::error::EngineError;

/// What is trained from some step on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Phase {
    /// SH coefficients that have offsets; never fewer than in the phase before.
    #[serde(with = "bases")]
    pub bases: OffsetBases,
    /// As [`super::Fidelity::visibility_share`]; never less than in the phase before.
    pub visibility_share: f32,
    /// Training clips, the first of [`super::TrainingViews::clips`]; never fewer than in the phase before.
    pub clips: u32,
    /// Most steps of this phase; of all but the last, all of its steps, in which the rates go down their cosine once.
    pub steps: usize,
}

/// What held-out clips must show for a mark to be good enough.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Aim {
    /// Largest p-value of a clip that proves the message alone.
    pub p_value: f64,
    /// Least share of the clips that do.
    pub proven: f64,
    /// Least share of the message's bits right, by the mean logits of each clip.
    pub accuracy: f64,
}

/// Phases, and when the next begins and the last ends.
///
/// No phase changes the extractor: that of `joint` is trained with the message and gives no exact p-value, which is for
/// whoever embeds to choose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AdaptiveSchedule {
    /// Steps from one evaluation of the held-out clips to the next in the last phase, at least 1. The others have one,
    /// at the end: while the rates are high a mark is noise in good part, and reads worse than it will.
    pub every: usize,
    /// Evaluations in a row without progress after which the last phase has given what it can, at least 1.
    pub patience: u32,
    /// Held-out clips.
    pub held_out: u32,
    /// When the mark is good enough.
    pub aim: Aim,
    /// From the least to the most.
    pub phases: Vec<Phase>,
}

impl AdaptiveSchedule {
    /// Whether a phase is the last, if there is such a phase at all.
    pub(in super::super) fn is_last(&self, phase: usize) -> bool {
        phase + 1 >= self.phases.len()
    }

    /// Whether an embedding can go by it with so many training clips.
    pub(in super::super) fn is_sensible(&self, clips: u32) -> bool {
        let grows = |pair: &[Phase]| {
            let [a, b] = pair else { return false };
            a.clips <= b.clips && a.visibility_share <= b.visibility_share && a.bases.count() <= b.bases.count()
        };
        let is_share = |share: f32| share > 0.0 && share <= 1.0;
        let fits = |p: &Phase| is_share(p.visibility_share) && (1..=clips).contains(&p.clips) && p.steps > 0;
        let counts = self.every > 0 && self.patience > 0 && self.held_out > 0 && !self.phases.is_empty();
        let Aim { p_value, proven, accuracy } = self.aim;
        let aims = [p_value, proven, accuracy].iter().all(|share| (0.0..=1.0).contains(share));
        counts && aims && self.phases.iter().all(fits) && self.phases.windows(2).all(grows)
    }

    pub(super) fn validate(&self, clips: u32) -> Result<(), EngineError> {
        if self.is_sensible(clips) {
            return Ok(());
        }
        Err(EngineError::Usage {
            what: "schedule".to_owned(),
            got: format!("{self:?}"),
            expected: "phases that each have as much as the one before, a p-value and shares from 0 to 1, and no zeros"
                .to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_phase_has_what_the_one_before_has() {
        let first = Phase { bases: OffsetBases::Dc, visibility_share: 0.9, clips: 2, steps: 100 };
        let good = AdaptiveSchedule {
            every: 10,
            patience: 2,
            held_out: 3,
            aim: Aim { p_value: 1e-3, proven: 0.75, accuracy: 0.75 },
            phases: vec![first, Phase { visibility_share: 1.0, clips: 4, ..first }],
        };
        assert!(good.is_sensible(4), "as it is meant");
        assert!(!good.is_sensible(3), "more clips than there are");
        let with = |change: &dyn Fn(&mut AdaptiveSchedule)| {
            let mut schedule = good.clone();
            change(&mut schedule);
            schedule.is_sensible(4)
        };
        let changes: [&dyn Fn(&mut AdaptiveSchedule); 12] = [
            &|s| s.phases.clear(),
            &|s| s.phases[1].visibility_share = 0.5,
            &|s| s.phases[1].clips = 1,
            &|s| s.phases[0].bases = OffsetBases::All,
            &|s| s.phases[0].visibility_share = f32::NAN,
            &|s| s.phases[1].steps = 0,
            &|s| s.aim.p_value = f64::NAN,
            &|s| s.aim.accuracy = 1.5,
            &|s| s.aim.proven = -0.1,
            &|s| s.every = 0,
            &|s| s.patience = 0,
            &|s| s.held_out = 0,
        ];
        for (i, change) in changes.into_iter().enumerate() {
            assert!(!with(change), "change {i} makes no sense");
        }
    }
}
