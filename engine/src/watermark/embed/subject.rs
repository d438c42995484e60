//! What an embedding works on, and what it leaves.

use std::collections::BTreeMap;

use guard4d_kernels::Device;

use super::report::{HeldOutEvaluation, PhaseReport};
use crate::evidence::message::Message;
use crate::networks::clip::ClipModel;
use crate::scene::Model;
use crate::watermark::extractor::weights::ExtractorWeights;
use crate::watermark::key::owner_key::Key;
use crate::watermark::step_part::StepPart;

/// What an embedding works on.
#[derive(Clone, Copy, Debug)]
pub struct Subject<'a> {
    /// Device.
    pub device: &'a Device,
    /// Frozen CLIP.
    pub clip: &'a ClipModel,
    /// Owner key.
    pub key: &'a Key,
    /// Unmarked model.
    pub model: &'a Model,
    /// Message to write.
    pub message: &'a Message,
}

/// Where the extractor comes from that an embedding optimises the offsets through.
#[derive(Clone, Copy, Debug)]
pub enum Start<'a> {
    /// It is fitted to the unmarked asset; `joint` then goes on training its R.
    Fit,
    /// This one, which stays as it is: another copy of an asset for the extractor that reads the first one.
    Frozen(&'a ExtractorWeights),
}

/// A finished embedding.
#[derive(Debug)]
pub struct Embedded {
    /// Marked SH coefficients `[N,16,3]`.
    pub sh_coeffs: Vec<f32>,
    /// The private extractor.
    pub extractor: ExtractorWeights,
    /// Seconds per stage.
    pub seconds: BTreeMap<String, f64>,
    /// Device seconds of training by kernel.
    pub device_seconds: BTreeMap<&'static str, f64>,
    /// Device seconds of training by part; parts that took none are 0.
    pub part_seconds: BTreeMap<StepPart, f64>,
    /// Steps taken.
    pub steps: usize,
    /// What held-out clips showed meanwhile.
    pub evaluations: Vec<HeldOutEvaluation>,
    /// What each phase of the schedule bought, where there was one.
    pub phases: Vec<PhaseReport>,
    /// Clips made; more than there are if the memory budget did not hold them all.
    pub clips_made: usize,
    /// Whether the backward pass computed activations again because the memory budget did not hold them.
    pub recomputed: bool,
    /// Running mean of the squared error of training frames.
    pub mse: f32,
}

impl Embedded {
    /// How much stronger the mark must be for training frames to come down to `psnr` dB; below 1 if weaker.
    ///
    /// Colours are linear in the offsets as long as none is clamped, so this is off by what clamping takes.
    #[must_use]
    pub fn strength_for(&self, psnr: f32) -> f32 {
        if self.mse > 0.0 { (10f32.powf(-0.1 * psnr) / self.mse).sqrt() } else { 1.0 }
    }

    /// The coefficients `clean + strength × offsets`; `clean` are those of the unmarked model.
    #[must_use]
    pub fn with_strength(&self, clean: &[f32], strength: f32) -> Vec<f32> {
        clean.iter().zip(&self.sh_coeffs).map(|(c, m)| if c == m { *m } else { c + strength * (m - c) }).collect()
    }
}
