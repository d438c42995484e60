//! What the settings say of a single step: which control it reads, what it distorts, what it compares by LPIPS.

use rand_chacha::ChaCha20Rng;

use super::embed_config::EmbedConfig;
use super::extractor::JointConfig;
use super::terms::ControlClips;
use crate::base::prf::{uniform_below, uniform_unit};
use crate::picture::distortion::Drawn;

/// Steps of the try-out of a rotation; the rates go down to their floor in them.
pub(in super::super) const TRY_OUT_STEPS: usize = 12;

/// What a step reads beside the marked clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in super::super) enum ControlTurn {
    /// Nothing, and R stays as it was fitted.
    Held,
    /// Nothing.
    Skipped,
    /// The unmarked clip.
    Clean,
    /// The unmarked clip with noise.
    Noisy,
}

impl EmbedConfig {
    /// What step number `step` reads beside the marked clip: of `joint` every `control_every`-th step has a control, by
    /// turns clean and noisy if both are asked for.
    pub(in super::super) fn control_turn(&self, step: usize) -> ControlTurn {
        let Some(JointConfig { control_every, control_clips, .. }) = self.extractor.joint() else {
            return ControlTurn::Held;
        };
        let every = *control_every as usize;
        let Some(step) = step.checked_sub(self.held_steps()) else { return ControlTurn::Held };
        if !step.is_multiple_of(every) {
            return ControlTurn::Skipped;
        }
        match (control_clips, (step / every).is_multiple_of(2)) {
            (ControlClips::Clean, _) | (ControlClips::Both, true) => ControlTurn::Clean,
            (ControlClips::Noisy, _) | (ControlClips::Both, false) => ControlTurn::Noisy,
        }
    }

    /// Steps before R is trained.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count")]
    fn held_steps(&self) -> usize {
        self.extractor.joint().map_or(0, |joint| (joint.tmsd_held * self.optimiser.steps as f32) as usize)
    }

    /// Steps from one control to the next.
    pub(in super::super) fn control_every(&self) -> u32 {
        self.extractor.joint().map_or(1, |joint| joint.control_every)
    }

    /// Whether some steps read the marked clip alone, and others a control too.
    pub(in super::super) fn goes_without_control(&self) -> bool {
        self.extractor.joint().is_some() && (self.control_every() > 1 || self.held_steps() > 0)
    }

    /// Clips that the extractor reads in a step with a control: the marked one and, for `joint`, that control.
    pub(in super::super) fn branches(&self) -> usize {
        if self.extractor.joint().is_some() { 2 } else { 1 }
    }

    /// First row and column of what step number `step` compares by LPIPS, if it does.
    pub(in super::super) fn lpips_turn(&self, step: usize, rng: &mut ChaCha20Rng) -> Option<[usize; 2]> {
        let term = self.objective.trained_lpips().filter(|term| step.is_multiple_of(term.every as usize))?;
        let (frame, part) = (self.views.frame_size(), term.part_of(self.views.frame_size()));
        let mut first = |whole: usize, part: usize| match u32::try_from(whole - part) {
            Ok(0) | Err(_) => 0,
            Ok(spare) => uniform_below(rng, spare + 1) as usize,
        };
        Some([first(frame.height, part.height), first(frame.width, part.width)])
    }

    /// What the clip of step number `step` goes through before CLIP sees it, if anything.
    pub(in super::super) fn distortion_turn(&self, step: usize, rng: &mut ChaCha20Rng) -> Option<Drawn> {
        let all = self.objective.distortions.len();
        let kinds = u32::try_from(all).ok().filter(|n| *n > 0)?;
        let index = uniform_below(rng, kinds + 1) as usize;
        let share = uniform_unit(rng);
        let stream = u32::try_from(step).unwrap_or(u32::MAX);
        (index < all).then_some(Drawn { index, share, seed: !self.seed, stream })
    }

    /// Steps after which controls and LPIPS come in the same order again.
    pub(in super::super) fn round(&self) -> usize {
        let every = self.objective.trained_lpips().map_or(1, |term| term.every) as usize;
        let control = self.control_every() as usize;
        (1..=every).map(|times| times * control).find(|steps| steps.is_multiple_of(every)).unwrap_or(control)
    }

    /// Steps of all try-outs of rotations.
    pub(in super::super) fn try_out_steps(&self) -> usize {
        let rotations = self.extractor.rotations();
        if rotations > 1 { rotations as usize * TRY_OUT_STEPS } else { 0 }
    }
}
