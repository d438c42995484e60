//! What steps, evaluations and phases of training report.

use serde::{Deserialize, Serialize};

use crate::picture::metrics::Decibels;

/// What one step reports.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StepReport {
    /// Message loss.
    pub message: f32,
    /// Control loss; 0 in a step without a control.
    pub control: f32,
    /// Mean square of the mark.
    pub mse: f32,
    /// Reconstruction loss (L1 and 1 − SSIM); 0 when its weight is.
    pub recon: f32,
    /// LPIPS; 0 in a step that does not compare by it.
    pub lpips: f32,
    /// Offset penalty; 0 when its weight is.
    pub offset: f32,
    /// Weighted sum of the losses.
    pub total: f32,
    /// Share of the message's bits that the clip's frames carry.
    pub bit_accuracy: f32,
    /// The rotation that is tried out, before training begins.
    pub key_rotation: Option<u32>,
    /// The result on held-out clips, after the steps that it is measured at.
    pub held_out: Option<HeldOutReport>,
}

/// What a mark is worth on clips that no step is taken on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutReport {
    /// Share of the message's bits that the clips' frames carry. Where R is trained, the zero of each bit is the mean
    /// logit of the unmarked clips, because the extractor's own is set when training ends.
    pub bit_accuracy: f32,
    /// The same of whole clips, as `verify` reads them: by the mean logits of their frames.
    pub clip_accuracy: f32,
    /// Share of the clips that each prove the message alone: by the soft score, at the p-value of the schedule's
    /// [`Aim`] or, without one, at the rate of `verify`.
    ///
    /// [`Aim`]: super::Aim
    pub proven: f32,
    /// Fidelity in dB, marked against unmarked 8-bit frames; infinite where no mark shows.
    pub psnr: f32,
}

/// The figures of held-out clips after some step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldOutEvaluation {
    /// Steps taken.
    pub step: usize,
    /// See [`HeldOutReport::bit_accuracy`].
    pub bit_accuracy: f32,
    /// See [`HeldOutReport::clip_accuracy`].
    pub clip_accuracy: f32,
    /// See [`HeldOutReport::proven`].
    pub proven: f32,
    /// See [`HeldOutReport::psnr`].
    pub psnr: Decibels,
}

impl HeldOutEvaluation {
    pub(super) fn new(step: usize, report: &HeldOutReport) -> Self {
        let HeldOutReport { bit_accuracy, clip_accuracy, proven, psnr } = *report;
        Self { step, bit_accuracy, clip_accuracy, proven, psnr: Decibels(f64::from(psnr)) }
    }
}

/// Why a phase ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StopReason {
    /// Held-out clips showed what was asked for.
    Enough,
    /// They showed no progress any more.
    Flat,
    /// Its steps were used up.
    Steps,
}

/// What a phase bought. Its seconds are among those of the embedding.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PhaseReport {
    /// Splats that could get offsets.
    pub splats: usize,
    /// Offsets that were trained: floats.
    pub offsets: usize,
    /// Training clips.
    pub clips: u32,
    /// Steps taken in it, those that settle the mark not counted.
    pub steps: usize,
    /// Why it ended.
    pub stop_reason: StopReason,
    /// The last evaluation in it.
    pub evaluation: HeldOutEvaluation,
}
