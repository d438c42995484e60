//! Ending training when the mark is good enough, on clips that no step is taken on.

use serde::Serialize;

use super::config::EmbedConfig;
use super::step::HeldOutReport;
use crate::train::schedule::cosine;

/// Looks in a row that must find the mark good enough: one may be luck.
const LOOKS: u32 = 2;
/// Steps that are taken after that while the rates fall to their floor, which settles the mark.
const SETTLING_STEPS: usize = 25;
/// Fidelity that may be missing when a look finds the mark good enough, dB; the hold makes up for it while the mark settles.
const PSNR_SLACK_DB: f32 = 0.25;

/// When training ends before its last step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StopRule {
    /// Share of the message's bits that held-out clips must show beyond doubt, see [`HeldOutReport::sure`].
    pub sure: f32,
    /// Steps from one look to the next, at least 1.
    pub every: usize,
}

/// Where an embedding stands by its rule.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Standing {
    /// Looks in a row that found the mark good enough.
    pub(super) met: u32,
    /// Steps taken when that was often enough.
    pub(super) decided_at: Option<usize>,
}

impl Standing {
    /// Takes in a look after `step` steps.
    pub(super) fn look(&mut self, config: &EmbedConfig, step: usize, report: &HeldOutReport) {
        let Some(rule) = config.stop else { return };
        let is_met = report.sure >= rule.sure && report.psnr >= config.target_psnr - PSNR_SLACK_DB;
        self.met = if is_met { self.met + 1 } else { 0 };
        if self.met >= LOOKS && self.decided_at.is_none() {
            self.decided_at = Some(step);
        }
    }

    /// Steps in all.
    pub(super) fn steps(&self, config: &EmbedConfig) -> usize {
        self.decided_at.map_or(config.steps, |at| config.steps.min(at + SETTLING_STEPS))
    }

    /// Share of the learning rates in step number `step`.
    pub(super) fn decay(&self, config: &EmbedConfig, step: usize) -> f32 {
        let planned = |step: usize| cosine(step, config.steps, config.lr_floor);
        match self.decided_at {
            None => planned(step),
            Some(at) => planned(at) * cosine(step - at, SETTLING_STEPS, config.lr_floor),
        }
    }
}
