//! One training step: render, lose, go back, update. No I/O, no allocation.

use std::sync::Arc;
use std::time::Instant;

use guard4d_kernels::image::noise::{self, Noise};
use guard4d_kernels::image::quantize;
use guard4d_kernels::image::resize::{self, ImageSize, Onward, ResizePlan};
use guard4d_kernels::loss::bce::{self, Groups, Objective};
use guard4d_kernels::loss::offset_penalty::{self, Blocks};
use guard4d_kernels::loss::pixel::{self, PixelWeights};
use guard4d_kernels::loss::ssim::{self, SsimPair, SsimScratch};
use guard4d_kernels::loss::sum::SumScratch;
use guard4d_kernels::loss::{PixelPair, Term};
use guard4d_kernels::nn::axpy;
use guard4d_kernels::optim::adam::{self, AdamConfig, AdamState, Tail};
use guard4d_kernels::shape::Accumulate;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder, Timings};

use super::clips::TrainingClip;
use super::config::{ControlTurn, EmbedConfig};
use super::copies::Copies;
use super::perception::Perception;
use super::pool::{ClipPool, is_over_budget};
use super::repeated::Repeated;
use crate::distortion::{Drawn, Layer};
use crate::error::EngineError;
use crate::render::{OffsetBases, Offsets, Renderer};
use crate::scene::gaussians::CHANNELS;
use crate::scene::{Model, narrow};
use crate::watermark::decoder::{Decoder, DecoderPass};
use crate::watermark::extractor::{CLIP_FRAMES, FeatureExtractor, Training};
use crate::watermark::message::Message;
use crate::watermark::statistics::SoftScoreNull;

/// Slots of the value buffer; `loss/pixel` fills the first two in this order.
const MSE: usize = 0;
const L1: usize = 1;
const DISSIMILARITY: usize = 2;
const OFFSET: usize = 3;
const NUM_VALUES: usize = 4;

/// Offsets, renderer and full-size clip buffers.
pub(super) struct Stage {
    pub(super) renderer: Renderer,
    pub(super) resize: ResizePlan,
    pub(super) resize_scratch: Buffer<f32>,
    pub(super) background: [f32; 3],
    pub(super) num_splats: usize,
    pub(super) sh_degree: u32,
    /// SH coefficients that have offsets.
    pub(super) bases: OffsetBases,
    /// Offsets, N rows as the bases lay them out.
    pub(super) offsets: Buffer<f32>,
    pub(super) offsets_state: AdamState,
    pub(super) v_offsets: Buffer<f32>,
    pub(super) penalty_sums: SumScratch,
    pub(super) raw: Buffer<f32>,
    pub(super) marked: Buffer<f32>,
    /// Gradient of the losses that look at pixels; empty when none has a weight.
    pub(super) v_marked: Buffer<f32>,
    pub(super) v_raw: Buffer<f32>,
    pub(super) resized: Buffer<f32>,
    pub(super) noisy_resized: Buffer<f32>,
    /// Room for distorted clips, where training has some.
    pub(super) copies: Option<Copies>,
}

impl Stage {
    /// Zero offsets on `model`, and room for clips that CLIP sees at `side` × `side` pixels.
    pub(super) fn new(device: &Device, model: &Model, config: &EmbedConfig, side: usize) -> Result<Self, EngineError> {
        let size = config.frame_size();
        let resize = ResizePlan::new(device, size, ImageSize { height: side, width: side })?;
        let full = |name: &str| device.buffer(&format!("stage.{name}"), CLIP_FRAMES * size.height * size.width * 4);
        let small = |name: &str| device.buffer(&format!("stage.{name}"), CLIP_FRAMES * side * side * 4);
        let num_splats = model.gaussians.len();
        let offsets = num_splats * config.bases.floats();
        Ok(Self {
            renderer: Renderer::new(device)?,
            resize_scratch: resize.scratch(device, CLIP_FRAMES)?,
            resize,
            background: model.background,
            num_splats,
            sh_degree: model.gaussians.sh_degree,
            bases: config.bases,
            offsets: device.buffer("offsets", offsets)?,
            offsets_state: AdamState::new(device, "offsets", offsets)?,
            v_offsets: device.buffer("v_offsets", offsets)?,
            penalty_sums: SumScratch::new(device, offsets.div_ceil(4))?,
            raw: full("raw")?,
            marked: full("marked")?,
            v_marked: if config.looks_at_pixels() { full("v_marked")? } else { device.buffer("stage.v_marked", 0)? },
            v_raw: full("v_raw")?,
            resized: small("resized")?,
            noisy_resized: small("noisy_resized")?,
            copies: Copies::new(device, config)?,
        })
    }

    /// Marked frames of a clip as in [`Self::draw`], and at CLIP's size in `self.resized`.
    pub(super) fn render(&mut self, rec: &mut Recorder, clip: &TrainingClip) -> Result<(), EngineError> {
        self.draw(rec, clip)?;
        Ok(self.shrink(rec)?)
    }

    /// Marked frames of a clip, clamped and rounded as a video holds them, in `self.marked`. Rounding passes its gradient
    /// through, clamping does not.
    fn draw(&mut self, rec: &mut Recorder, clip: &TrainingClip) -> Result<(), EngineError> {
        let offsets = Offsets { data: &self.offsets, bases: self.bases };
        self.renderer.forward_clip(rec, &clip.plans, Some(offsets), self.background, &mut self.raw)?;
        quantize::forward(rec, &self.raw, &mut self.marked)?;
        Ok(())
    }

    /// The marked frames at CLIP's size, in `self.resized`.
    fn shrink(&mut self, rec: &mut Recorder) -> Result<(), KernelError> {
        resize::forward(rec, &self.resize, &self.marked, &mut self.resized, &mut self.resize_scratch)
    }

    /// The unmarked frames distorted by a layer that is not the stage's own, at CLIP's size in `self.noisy_resized`.
    pub(super) fn copy_control(
        &mut self,
        rec: &mut Recorder,
        clip: &TrainingClip,
        (layer, drawn): (&mut Layer, Drawn),
    ) -> Result<(), KernelError> {
        // Both are free between steps.
        layer.forward(rec, drawn, &clip.reference, &mut self.v_raw)?;
        self.shrink_control(rec)
    }

    /// What is in `self.v_raw`, rounded to 8 bits and brought to CLIP's size.
    fn shrink_control(&mut self, rec: &mut Recorder) -> Result<(), KernelError> {
        quantize::forward(rec, &self.v_raw, &mut self.marked)?;
        resize::forward(rec, &self.resize, &self.marked, &mut self.noisy_resized, &mut self.resize_scratch)
    }

    /// The noisy control at CLIP's size, rounded before it is resized, in `self.noisy_resized`.
    pub(super) fn noisy(&mut self, rec: &mut Recorder, clip: &TrainingClip, noise: &Noise) -> Result<(), KernelError> {
        // `v_raw` is free until the backward pass, `marked` once it is resized and compared.
        noise::forward(rec, noise, &clip.reference, &mut self.v_raw)?;
        self.shrink_control(rec)
    }
}

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
    /// The mixing that is tried out, before training begins.
    pub mixing: Option<u32>,
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
    /// Share of the clips that each prove the message alone: by the soft score, at the p-value of the ladder's [`Aim`] or,
    /// without one, at the rate of `verify`.
    ///
    /// [`Aim`]: super::Aim
    pub proven: f32,
    /// Fidelity in dB, marked against unmarked 8-bit frames; infinite where no mark shows.
    pub psnr: f32,
}

/// Rates and scales of one step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rates {
    /// Factor on both learning rates.
    pub(super) decay: f32,
    /// Factor on the offsets that holds the fidelity.
    pub(super) keep: f32,
    /// Standard deviation of the noisy control.
    pub(super) sigma: f32,
    /// Stream of its noise.
    pub(super) stream: u32,
    /// Control that the step reads, if it trains R.
    pub(super) control: ControlTurn,
    /// First row and column of what is compared by LPIPS, in the steps that do.
    pub(super) lpips: Option<[usize; 2]>,
    /// What both clips go through before CLIP sees them.
    pub(super) distortion: Option<Drawn>,
}

/// Both parameter groups of the offsets.
fn offset_adam(config: &EmbedConfig, rates: Rates, sh_degree: u32) -> AdamConfig {
    let lr = config.lr_dc * rates.decay;
    let tail = match config.bases {
        OffsetBases::Dc => None,
        OffsetBases::All => Some(Tail { row: config.bases.floats(), head: CHANNELS, lr: lr * config.lr_rest_share }),
    };
    let bound = config.largest_offset(sh_degree).map_or(f32::INFINITY, narrow);
    AdamConfig { lr, keep: rates.keep, bound, tail, ..AdamConfig::default() }
}

/// The extractor in training, with its losses.
pub(super) struct Critic {
    pub(super) features: FeatureExtractor,
    pub(super) decoder: Decoder,
    /// Of all branches, and of the marked clip alone if steps go without a control.
    pub(super) passes: Vec<DecoderPass>,
    pub(super) repeated: Repeated,
    target: Buffer<f32>,
    message: Message,
    objective: Objective,
    values: Buffer<f32>,
    branches: Vec<Branch>,
    /// What the host reads of a step, in one piece: `values`, the branches' losses, logits of all branches, LPIPS.
    report: Buffer<f32>,
    scratch_logits: Buffer<f32>,
    sums: SumScratch,
    /// Working memory for SSIM, when it is part of the loss.
    similarity: Option<SsimScratch>,
    /// LPIPS, when it is part of the loss.
    pub(super) perception: Option<Perception>,
}

/// Logits of one clip and their loss.
struct Branch {
    logits: Buffer<f32>,
    v_logits: Buffer<f32>,
    value: Buffer<f32>,
}

impl Critic {
    pub(super) fn new(
        device: &Device,
        features: FeatureExtractor,
        decoder: Decoder,
        message: &Message,
        config: &EmbedConfig,
    ) -> Result<Self, EngineError> {
        let branches = features.branches();
        let bits: Vec<f32> = message.bits().map(|b| f32::from(u8::from(b))).collect();
        let perception = Perception::new(device, config)?;
        let logits = branches * CLIP_FRAMES * bits.len();
        let reported = NUM_VALUES + branches + logits + perception.as_ref().map_or(0, |p| p.values().len());
        let branch = || -> Result<Branch, KernelError> {
            Ok(Branch {
                logits: device.buffer("critic.logits", CLIP_FRAMES * bits.len())?,
                v_logits: device.buffer("critic.v_logits", CLIP_FRAMES * bits.len())?,
                value: device.buffer("critic.value", 1)?,
            })
        };
        let size = config.frame_size();
        Ok(Self {
            passes: match config.goes_without_control() {
                false => vec![decoder.pass(device, branches * CLIP_FRAMES)?],
                true => vec![decoder.pass(device, branches * CLIP_FRAMES)?, decoder.pass(device, CLIP_FRAMES)?],
            },
            repeated: Repeated::default(),
            target: device.buffer_from("critic.target", &bits)?,
            values: device.buffer("critic.values", NUM_VALUES)?,
            branches: (0..branches).map(|_| branch()).collect::<Result<_, _>>()?,
            report: device.readback("critic.report", reported)?,
            scratch_logits: device.buffer("critic.scratch_logits", CLIP_FRAMES * bits.len())?,
            sums: SumScratch::new(device, CLIP_FRAMES * size.height * size.width)?,
            similarity: match config.uses_ssim() {
                true => Some(SsimScratch::new(device, size, CLIP_FRAMES)?),
                false => None,
            },
            objective: match config.margin {
                margin if margin > 0.0 => Objective::Margin { margin },
                _ => Objective::Bce,
            },
            message: *message,
            perception,
            features,
            decoder,
        })
    }

    /// Reads what CLIP says by another decoder of the same sizes.
    pub(super) fn replace_decoder(&mut self, decoder: Decoder) {
        self.decoder = decoder;
        self.repeated.forget();
    }

    /// R is trained exactly when control branches hold it back.
    pub(super) fn training(&self) -> Training {
        if self.branches.len() > 1 { Training::Tmsd } else { Training::Frozen }
    }

    /// Logits of the last control, if there are controls.
    pub(super) fn control_logits(&mut self) -> Option<&mut Buffer<f32>> {
        self.branches.get_mut(1).map(|branch| &mut branch.logits)
    }

    /// Whether a step trains R.
    pub(super) fn training_in(&self, rates: Rates) -> Training {
        if rates.control == ControlTurn::Held { Training::Frozen } else { self.training() }
    }

    /// The control of a step; without R in training there is none.
    fn control(&self, rates: Rates) -> ControlTurn {
        match self.training() {
            Training::Tmsd => rates.control,
            Training::Frozen => ControlTurn::Held,
        }
    }

    /// Which of `self.passes` a step goes through.
    pub(super) fn pass_index(&self, rates: Rates) -> usize {
        let alone = matches!(rates.control, ControlTurn::Held | ControlTurn::Skipped);
        usize::from(self.training() == Training::Tmsd && alone)
    }

    /// A clip for a step. Where the budget has room for none beside the activations, those make room that the backward
    /// pass can compute again.
    pub(super) fn clip(
        &mut self,
        pool: &mut ClipPool,
        stage: &mut Stage,
        index: usize,
    ) -> Result<Arc<TrainingClip>, EngineError> {
        let clip = pool.get(index, stage);
        if is_over_budget(&clip) && self.features.forget_activations() {
            self.repeated.forget();
            tracing::debug!("activations are computed again from now on");
            return pool.get(index, stage);
        }
        clip
    }

    /// One step on `clip`. Returns what it saw before the update, and the device time of every pass.
    pub(super) fn step(
        &mut self,
        device: &Device,
        stage: &mut Stage,
        clip: &TrainingClip,
        config: &EmbedConfig,
        rates: Rates,
    ) -> Result<(StepReport, Timings), EngineError> {
        let started = Instant::now();
        let mut rec = device.recorder()?;
        stage.draw(&mut rec, clip)?;
        self.fidelity(&mut rec, stage, clip, config)?;
        if let (Some(perception), Some(corner)) = (&mut self.perception, rates.lpips) {
            perception.step(&mut rec, (&stage.marked, clip), corner, &mut stage.v_marked)?;
        }
        match rates.distortion {
            Some(drawn) => stage.distort(&mut rec, drawn)?,
            None => stage.shrink(&mut rec)?,
        }
        self.look(&mut rec, stage, clip, config, rates)?;
        self.read_and_return(&mut rec, device, config, rates)?;
        self.update(&mut rec, stage, clip, config, rates)?;
        self.gather(&mut rec)?;
        self.repeated.last_step = started.elapsed();
        let timings = rec.submit()?;
        if let Some(perception) = &mut self.perception {
            perception.remember(clip);
        }
        Ok((self.report(config, rates)?, timings))
    }

    /// Reconstruction loss, with its gradient in `stage.v_marked` where that is wanted, and the squared error.
    fn fidelity(
        &mut self,
        rec: &mut Recorder,
        stage: &mut Stage,
        clip: &TrainingClip,
        config: &EmbedConfig,
    ) -> Result<(), KernelError> {
        let values = &mut self.values;
        let pair = PixelPair {
            image: &stage.marked,
            image_px: 0,
            reference: &clip.reference,
            reference_px: 0,
            num_px: stage.marked.len() / 4,
        };
        // The squared error is only measured: the fidelity is held by scaling the offsets.
        let weights = PixelWeights { square: 0.0, absolute: 1.0 - config.lambda_ssim };
        let term = Term { values, slot: MSE, weight: config.lambda_recon, accumulate: Accumulate::Overwrite };
        let v_marked = Some(&mut stage.v_marked).filter(|v| !v.is_empty());
        pixel::step(rec, (&pair, weights), v_marked, term, &mut self.sums)?;
        if let (Some(moments), Some(scratch)) = (&clip.moments, &mut self.similarity) {
            let pair = SsimPair { clip: &stage.marked, reference: &clip.reference, moments };
            let weight = config.lambda_recon * config.lambda_ssim;
            let term = Term { values, slot: DISSIMILARITY, weight, accumulate: Accumulate::Add };
            ssim::step(rec, &pair, &mut stage.v_marked, term, scratch)?;
        }
        Ok(())
    }

    /// R of the marked clip and of the step's control.
    fn look(
        &mut self,
        rec: &mut Recorder,
        stage: &mut Stage,
        clip: &TrainingClip,
        config: &EmbedConfig,
        rates: Rates,
    ) -> Result<(), KernelError> {
        match (self.control(rates), rates.distortion) {
            (ControlTurn::Held | ControlTurn::Skipped, _) => self.features.stack(rec, &[&stage.resized]),
            (ControlTurn::Clean | ControlTurn::Noisy, Some(drawn)) => {
                stage.distort_control(rec, clip, drawn)?;
                self.features.stack(rec, &[&stage.resized, &stage.noisy_resized])
            }
            (ControlTurn::Clean, None) => self.features.stack(rec, &[&stage.resized, &clip.resized]),
            (ControlTurn::Noisy, None) => {
                stage.noisy(rec, clip, &Noise { sigma: rates.sigma, seed: config.seed, stream: rates.stream })?;
                self.features.stack(rec, &[&stage.resized, &stage.noisy_resized])
            }
        }
    }

    /// Message loss on what sets the marked clip's logits apart from the control's, and the control loss.
    ///
    /// A message loss on the marked logits alone is cheapest to lower by an R that says the message whatever it
    /// sees; here such an R gains nothing. A step without a control takes the last one's logits for constants, and the
    /// next control's gradient makes up for it: see [`EmbedConfig::control_every`].
    pub(super) fn message_losses(
        &mut self,
        rec: &mut Recorder,
        config: &EmbedConfig,
        rates: Rates,
    ) -> Result<(), KernelError> {
        let bits = self.target.len();
        let groups = Groups { groups: 1, rows: CLIP_FRAMES, bits };
        let len = CLIP_FRAMES * bits;
        let control = self.control(rates);
        let read = match control {
            ControlTurn::Held | ControlTurn::Skipped => 1,
            ControlTurn::Clean | ControlTurn::Noisy => self.branches.len(),
        };
        let pass = self.pass_index(rates);
        let pass = &mut self.passes[pass];
        for (i, branch) in self.branches.iter_mut().enumerate().take(read) {
            rec.copy(&pass.logits, i * len, &mut branch.logits, 0, len)?;
        }
        if let ([marked, control], true) = (self.branches.as_mut_slice(), control != ControlTurn::Held) {
            rec.copy(&marked.logits, 0, &mut self.scratch_logits, 0, len)?;
            axpy::forward(rec, -1.0, &self.scratch_logits, &control.logits, &mut marked.logits)?;
        }
        let repeats = config.control_every as f32;
        for (i, branch) in self.branches.iter_mut().enumerate().take(read) {
            let (objective, weight) = match i {
                0 => (self.objective, config.lambda_msg),
                _ => (config.control.objective(), config.lambda_msg * config.lambda_control * repeats),
            };
            bce::forward(rec, objective, groups, (&branch.logits, &self.target), &mut branch.value)?;
            let inputs = (&branch.logits, &self.target, &branch.value);
            bce::backward(rec, (objective, weight), groups, inputs, &mut branch.v_logits)?;
            rec.copy(&branch.v_logits, 0, &mut pass.v_logits, i * len, len)?;
        }
        if let [marked, control] = &self.branches[..read] {
            axpy::forward(rec, -repeats, &control.v_logits, &marked.v_logits, &mut self.scratch_logits)?;
            rec.copy(&self.scratch_logits, 0, &mut pass.v_logits, len, len)?;
        }
        Ok(())
    }

    /// Back through resize and renderer, then Adam.
    fn update(
        &mut self,
        rec: &mut Recorder,
        stage: &mut Stage,
        clip: &TrainingClip,
        config: &EmbedConfig,
        rates: Rates,
    ) -> Result<(), EngineError> {
        if let Some(drawn) = rates.distortion {
            stage.undistort(rec, drawn, &self.features.v_x)?;
        } else {
            let plus = Some(&stage.v_marked).filter(|v| !v.is_empty());
            let into = (&mut stage.v_raw, Onward { plus, clamped: Some(&stage.raw) });
            resize::backward(rec, &stage.resize, &self.features.v_x, into, &mut stage.resize_scratch)?;
        }
        rec.fill(&mut stage.v_offsets, 0.0);
        let offsets = Offsets { data: &stage.offsets, bases: stage.bases };
        stage.renderer.backward_clip(rec, &clip.plans, offsets, &stage.v_raw, &mut stage.v_offsets)?;
        if config.lambda_offset > 0.0 {
            let blocks = Blocks { bases: stage.bases, degree: stage.sh_degree, dc: 1.0, rest: 1.0 };
            let accumulate = Accumulate::Add;
            let term = Term { values: &mut self.values, slot: OFFSET, weight: config.lambda_offset, accumulate };
            let v_offsets = &mut stage.v_offsets;
            offset_penalty::step(rec, (&stage.offsets, blocks), v_offsets, term, &mut stage.penalty_sums)?;
        }
        adam::step(
            rec,
            &mut stage.offsets,
            &stage.v_offsets,
            &mut stage.offsets_state,
            &offset_adam(config, rates, stage.sh_degree),
        )?;
        if self.training_in(rates) == Training::Tmsd
            && let Some(tmsd) = self.features.tmsd()
        {
            let adam = AdamConfig { lr: config.lr_tmsd * rates.decay, ..AdamConfig::default() };
            tmsd.step(rec, &adam)?;
        }
        Ok(())
    }

    /// Copies what the host reads of a step into one buffer.
    fn gather(&mut self, rec: &mut Recorder) -> Result<(), KernelError> {
        rec.copy(&self.values, 0, &mut self.report, 0, NUM_VALUES)?;
        for (i, branch) in self.branches.iter().enumerate() {
            rec.copy(&branch.value, 0, &mut self.report, NUM_VALUES + i, 1)?;
        }
        let logits = &self.branches[0].logits;
        rec.copy(logits, 0, &mut self.report, NUM_VALUES + self.branches.len(), logits.len())?;
        if let Some(perception) = &self.perception {
            let values = perception.values();
            let at = self.report.len() - values.len();
            rec.copy(values, 0, &mut self.report, at, values.len())?;
        }
        Ok(())
    }

    fn report(&self, config: &EmbedConfig, rates: Rates) -> Result<StepReport, KernelError> {
        let read = self.report.read()?;
        let (values, rest) = read.split_at(NUM_VALUES);
        let (losses, logits) = rest.split_at(self.branches.len());
        let marked = &logits[..self.branches[0].logits.len()];
        let objective = config.control.objective();
        let control = match self.control(rates) {
            ControlTurn::Held | ControlTurn::Skipped => 0.0,
            ControlTurn::Clean | ControlTurn::Noisy => losses[1..].iter().fold(0.0, |sum, v| sum + objective.loss(*v)),
        };
        let recon = match config.lambda_recon > 0.0 {
            true => (1.0 - config.lambda_ssim) * values[L1] + config.lambda_ssim * values[DISSIMILARITY],
            false => 0.0,
        };
        let lpips = match (&self.perception, rates.lpips) {
            (Some(perception), Some(_)) => perception.score(&read[read.len() - perception.values().len()..]),
            _ => 0.0,
        };
        let (message, offset) = (losses[0], values[OFFSET]);
        let total = config.lambda_msg * (message + config.lambda_control * control)
            + config.lambda_recon * recon
            + config.lpips.as_ref().map_or(0.0, |term| term.lambda * lpips)
            + config.lambda_offset * offset;
        let bit_accuracy = share_right(marked, &vec![0.0; self.target.len()], &self.message);
        let mse = values[MSE];
        Ok(StepReport {
            message,
            control,
            mse,
            recon,
            lpips,
            offset,
            total,
            bit_accuracy,
            mixing: None,
            held_out: None,
        })
    }

    /// Fidelity and readability of the mark on clips that no step is taken on. Forward only, and without a trace:
    /// every buffer that it writes is written anew by the next step before that reads it.
    pub(super) fn measure(
        &mut self,
        device: &Device,
        stage: &mut Stage,
        pool: &mut ClipPool,
        config: &EmbedConfig,
    ) -> Result<HeldOutReport, EngineError> {
        let (len, at) = (self.branches[0].logits.len(), NUM_VALUES + self.branches.len());
        let (mut squares, mut marked, mut unmarked) = (0.0, Vec::new(), Vec::new());
        let clips = pool.held_out();
        for index in clips.clone() {
            let clip = self.clip(pool, stage, index)?;
            let mut rec = device.recorder()?;
            stage.render(&mut rec, &clip)?;
            self.fidelity(&mut rec, stage, &clip, config)?;
            let all = [&stage.resized, &clip.resized];
            self.features.forward(&mut rec, &all[..self.branches.len()])?;
            let pass = &mut self.passes[0];
            self.decoder.forward(&mut rec, self.features.features(), pass)?;
            rec.copy(&self.values, 0, &mut self.report, 0, NUM_VALUES)?;
            rec.copy(&pass.logits, 0, &mut self.report, at, len * self.branches.len())?;
            rec.submit()?;
            let read = self.report.read()?;
            let (of_marked, of_unmarked) = read[at..at + len * self.branches.len()].split_at(len);
            squares += read[MSE];
            marked.extend_from_slice(of_marked);
            unmarked.extend_from_slice(of_unmarked);
        }
        let psnr = -10.0 * (squares / clips.len() as f32).log10();
        let zero = column_means(&unmarked, self.target.len());
        let bit_accuracy = share_right(&marked, &zero, &self.message);
        let readings: Vec<f32> = marked.chunks_exact(len).flat_map(|clip| column_means(clip, zero.len())).collect();
        let clip_accuracy = share_right(&readings, &zero, &self.message);
        let sum: f32 = marked.iter().chain(&unmarked).sum();
        if psnr.is_nan() || !sum.is_finite() {
            return Err(EngineError::NotFinite { what: "held-out figures".to_owned(), got: f64::from(psnr + sum) });
        }
        let proven = share_proven(&readings, &zero, &self.message, config.proof(zero.len()))?;
        Ok(HeldOutReport { bit_accuracy, clip_accuracy, proven, psnr })
    }
}

/// Share of the message's bits that rows of logits show, each bit against its own `zero`.
fn share_right(logits: &[f32], zero: &[f32], message: &Message) -> f32 {
    let rows = logits.chunks_exact(zero.len());
    let right = rows.flat_map(|row| row.iter().zip(zero).zip(message.bits())).filter(|((o, z), b)| (o > z) == *b);
    right.count() as f32 / logits.len() as f32
}

/// Share of the rows of logits that prove the message alone at a false-positive rate, see [`HeldOutReport::proven`].
fn share_proven(readings: &[f32], zero: &[f32], message: &Message, fpr: f64) -> Result<f32, EngineError> {
    let mut proven = 0;
    for row in readings.chunks_exact(zero.len()) {
        let moved: Vec<f64> = row.iter().zip(zero).map(|(o, z)| f64::from(o - z)).collect();
        proven += usize::from(SoftScoreNull::new(&moved)?.p_value(message)? <= fpr);
    }
    Ok(proven as f32 / (readings.len() / zero.len()) as f32)
}

/// Mean of each column; zeros without a row.
fn column_means(rows: &[f32], columns: usize) -> Vec<f32> {
    let share = 1.0 / (rows.len() / columns).max(1) as f32;
    let mut means = vec![0.0; columns];
    for row in rows.chunks_exact(columns) {
        means.iter_mut().zip(row).for_each(|(mean, v)| *mean += share * v);
    }
    means
}
