//! One training step: render, lose, go back, update. No I/O, no allocation.

use std::sync::Arc;
use std::time::{Duration, Instant};

use guard4d_kernels::loss::Term;
use guard4d_kernels::loss::bce::{self, Answers, Groups, Objective};
use guard4d_kernels::nn::axpy;
use guard4d_kernels::optim::adam::AdamConfig;
use guard4d_kernels::shape::Accumulate;
use guard4d_kernels::{Buffer, Device, KernelError, Recorder, Timings};

use super::buffers::TrainingBuffers;
use super::config::turns::ControlTurn;
use super::config::{EmbedConfig, JointConfig};
use super::fidelity_loss::{DISSIMILARITY, FidelityLoss, L1, MSE, NUM_VALUES, OFFSET};
use super::foretold::TakenOff;
use super::perception::Perception;
use super::pool::{ClipPool, is_out_of_memory};
use super::repeated::{Constants, Repeated, Repetition};
use super::report::StepReport;
use super::scores::share_right;
use super::step_inputs::StepInputs;
use super::training_clip::TrainingClip;
use crate::error::EngineError;
use crate::evidence::message::Message;
use crate::watermark::extractor::features::{FeatureExtractor, Training};
use crate::watermark::extractor::tmsd::Tmsd;
use crate::watermark::extractor::weights::CLIP_FRAMES;
use crate::watermark::key::decoder::{Decoder, DecoderPass};
use crate::watermark::step_part::StepPart;

/// The extractor in training, with its losses.
pub(super) struct ExtractorLoss {
    features: FeatureExtractor,
    decoder: Decoder,
    /// Of all branches, and of the marked clip alone if steps go without a control.
    passes: Vec<DecoderPass>,
    repeated: Repeated,
    target: Buffer<f32>,
    message: Message,
    objective: Objective,
    fidelity: FidelityLoss,
    branches: Vec<Branch>,
    /// What the host reads of a step, in one piece: fidelity, the branches' losses, logits of all branches, LPIPS.
    report: Buffer<f32>,
    scratch_logits: Buffer<f32>,
    /// LPIPS, when it is part of the loss.
    perception: Option<Perception>,
    /// What is taken off features before they are decoded, if anything is.
    content: Option<TakenOff>,
}

/// Logits of one clip and their loss.
struct Branch {
    logits: Buffer<f32>,
    v_logits: Buffer<f32>,
    value: Buffer<f32>,
}

/// A clip that no step is taken on, as it is read.
pub(super) struct ClipReading {
    /// Squared error of the mark.
    pub(super) mse: f32,
    /// Logits of the marked frames.
    pub(super) marked: Vec<f32>,
    /// Those of the unmarked ones, where R is trained.
    pub(super) unmarked: Vec<f32>,
}

impl ExtractorLoss {
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
                logits: device.buffer("loss.logits", CLIP_FRAMES * bits.len())?,
                v_logits: device.buffer("loss.v_logits", CLIP_FRAMES * bits.len())?,
                value: device.buffer("loss.value", 1)?,
            })
        };
        Ok(Self {
            passes: match config.goes_without_control() {
                false => vec![decoder.pass(device, branches * CLIP_FRAMES)?],
                true => vec![decoder.pass(device, branches * CLIP_FRAMES)?, decoder.pass(device, CLIP_FRAMES)?],
            },
            repeated: Repeated::default(),
            target: device.buffer_from("loss.target", &bits)?,
            fidelity: FidelityLoss::new(device, config)?,
            branches: (0..branches).map(|_| branch()).collect::<Result<_, _>>()?,
            report: device.readback("loss.report", reported)?,
            scratch_logits: device.buffer("loss.scratch_logits", CLIP_FRAMES * bits.len())?,
            objective: match config.objective.margin {
                margin if margin > 0.0 => Objective::Margin { margin },
                _ => Objective::Bce,
            },
            message: *message,
            perception,
            features,
            decoder,
            content: None,
        })
    }

    /// Takes off features what is foretold of them from now on.
    pub(super) fn take_off(&mut self, content: TakenOff) {
        self.content = Some(content);
        self.repeated.forget();
    }

    /// Gets ready for a step on this clip, or for reading it.
    pub(super) fn foretell(
        &mut self,
        device: &Device,
        buffers: &mut TrainingBuffers,
        number: usize,
        clip: &TrainingClip,
    ) -> Result<(), EngineError> {
        if let Some(content) = &mut self.content {
            content.foretell(device, buffers, number, clip)?;
        }
        Ok(())
    }

    /// Reads what CLIP says by another decoder of the same sizes.
    pub(super) fn replace_decoder(&mut self, decoder: Decoder) {
        self.decoder = decoder;
        self.repeated.forget();
    }

    /// Chooses how the passes that are the same in every step come to the device.
    pub(super) fn repeat(&mut self, how: Repetition) {
        self.repeated.how = how;
    }

    /// Host time of recording the last step.
    pub(super) fn recording_time(&self) -> Duration {
        self.repeated.last_step
    }

    /// Whether the backward pass computes activations again.
    pub(super) fn recomputes(&self) -> bool {
        self.features.recomputes()
    }

    /// R, when there is one.
    pub(super) fn tmsd(&mut self) -> Option<&mut Tmsd> {
        self.features.tmsd()
    }

    /// LPIPS, when it is part of the loss.
    pub(super) fn perception(&self) -> Option<&Perception> {
        self.perception.as_ref()
    }

    /// The message that is written.
    pub(super) fn message(&self) -> &Message {
        &self.message
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
    fn training_in(&self, inputs: StepInputs) -> Training {
        if inputs.control == ControlTurn::Held { Training::Frozen } else { self.training() }
    }

    /// The control of a step; without R in training there is none.
    fn control(&self, inputs: StepInputs) -> ControlTurn {
        match self.training() {
            Training::Tmsd => inputs.control,
            Training::Frozen => ControlTurn::Held,
        }
    }

    /// Which of `self.passes` a step goes through.
    fn pass_index(&self, inputs: StepInputs) -> usize {
        let alone = matches!(inputs.control, ControlTurn::Held | ControlTurn::Skipped);
        usize::from(self.training() == Training::Tmsd && alone)
    }

    /// A clip for a step. Where the budget has room for none beside the activations, those make room that the backward
    /// pass can compute again.
    pub(super) fn clip(
        &mut self,
        pool: &mut ClipPool,
        buffers: &mut TrainingBuffers,
        index: usize,
    ) -> Result<Arc<TrainingClip>, EngineError> {
        let clip = pool.get(index, buffers);
        if is_out_of_memory(&clip) && self.features.forget_activations() {
            self.repeated.forget();
            tracing::debug!("activations are computed again from now on");
            return pool.get(index, buffers);
        }
        clip
    }

    /// Makes room for what LPIPS keeps of a clip, in the steps that compare by it.
    pub(super) fn make_room(
        &mut self,
        device: &Device,
        pool: &ClipPool,
        clip: &TrainingClip,
        inputs: StepInputs,
    ) -> Result<(), EngineError> {
        match self.perception.as_mut().filter(|_| inputs.crop.is_some()) {
            Some(perception) => perception.make_room(device, pool, clip),
            None => Ok(()),
        }
    }

    /// One step on `clip`. Returns what it saw before the update, and the device time of every pass.
    pub(super) fn step(
        &mut self,
        device: &Device,
        buffers: &mut TrainingBuffers,
        clip: &TrainingClip,
        config: &EmbedConfig,
        inputs: StepInputs,
    ) -> Result<(StepReport, Timings), EngineError> {
        let started = Instant::now();
        let mut rec = device.recorder()?;
        buffers.draw(&mut rec, clip)?;
        self.fidelity.record(&mut rec, buffers, clip, config)?;
        if let (Some(perception), Some(corner)) = (&mut self.perception, inputs.crop) {
            StepPart::Losses.record(&mut rec, |rec| perception.step(rec, buffers.marked(), clip, corner))?;
        }
        buffers.shrink(&mut rec, inputs.distortion)?;
        self.stack(&mut rec, buffers, clip, inputs)?;
        self.read_and_return(&mut rec, device, config, inputs)?;
        self.update(&mut rec, buffers, clip, config, inputs)?;
        StepPart::Copies.record(&mut rec, |rec| self.gather(rec))?;
        self.repeated.last_step = started.elapsed();
        let timings = rec.submit()?;
        if let Some(perception) = &mut self.perception {
            perception.remember(clip);
        }
        Ok((self.report(config, inputs)?, timings))
    }

    /// R of the marked clip and of the step's control.
    fn stack(
        &mut self,
        rec: &mut Recorder,
        buffers: &mut TrainingBuffers,
        clip: &TrainingClip,
        inputs: StepInputs,
    ) -> Result<(), KernelError> {
        match (self.control(inputs), inputs.distortion) {
            (ControlTurn::Held | ControlTurn::Skipped, _) => self.features.stack(rec, &[buffers.resized()]),
            (ControlTurn::Clean | ControlTurn::Noisy, Some(drawn)) => {
                buffers.distorted_control(rec, clip, drawn)?;
                self.features.stack(rec, &[buffers.resized(), buffers.control()])
            }
            (ControlTurn::Clean, None) => {
                buffers.clean_control(rec, clip)?;
                self.features.stack(rec, &[buffers.resized(), buffers.control()])
            }
            (ControlTurn::Noisy, None) => {
                buffers.noisy_control(rec, clip, &inputs.noise)?;
                self.features.stack(rec, &[buffers.resized(), buffers.control()])
            }
        }
    }

    /// Records the passes that are the same in every step, or replays them.
    fn read_and_return(
        &mut self,
        rec: &mut Recorder,
        device: &Device,
        config: &EmbedConfig,
        inputs: StepInputs,
    ) -> Result<(), KernelError> {
        let joint = config.extractor.joint();
        let constants = Constants {
            pass: self.pass_index(inputs),
            recomputes: self.features.recomputes(),
            training: self.training_in(inputs),
            control: joint.map(|joint| joint.control),
            lambda_msg: config.objective.lambda_msg,
            lambda_control: joint.map_or(0.0, |joint| joint.lambda_control),
            control_every: config.control_every(),
        };
        let mut repeated = std::mem::take(&mut self.repeated);
        let done = repeated.play(rec, device, constants, |rec| self.record_repeated(rec, config, inputs));
        self.repeated = repeated;
        done
    }

    fn record_repeated(
        &mut self,
        rec: &mut Recorder,
        config: &EmbedConfig,
        inputs: StepInputs,
    ) -> Result<(), KernelError> {
        self.features.read(rec)?;
        let (training, pass) = (self.training_in(inputs), self.pass_index(inputs));
        StepPart::Clip.record(rec, |rec| self.decode(rec, pass))?;
        StepPart::Losses.record(rec, |rec| self.message_losses(rec, config, inputs))?;
        let pass = &mut self.passes[pass];
        StepPart::Clip.record(rec, |rec| self.decoder.backward(rec, pass))?;
        self.features.backward(rec, &pass.v_features, training)
    }

    /// Logits of what was read last.
    fn decode(&mut self, rec: &mut Recorder, pass: usize) -> Result<(), KernelError> {
        let Self { features, decoder, passes, content, .. } = self;
        let seen = match content {
            Some(content) => content.free(rec, features.features())?,
            None => features.features(),
        };
        decoder.forward(rec, seen, &mut passes[pass])
    }

    /// Message loss on what sets the marked clip's logits apart from the control's, and the control loss.
    ///
    /// A message loss on the marked logits alone is cheapest to lower by an R that says the message whatever it
    /// sees; here such an R gains nothing. A step without a control takes the last one's logits for constants, and the
    /// next control's gradient makes up for it: see [`JointConfig::control_every`].
    fn message_losses(
        &mut self,
        rec: &mut Recorder,
        config: &EmbedConfig,
        inputs: StepInputs,
    ) -> Result<(), KernelError> {
        let bits = self.target.len();
        let groups = Groups { groups: 1, rows: CLIP_FRAMES, bits };
        let len = CLIP_FRAMES * bits;
        let control = self.control(inputs);
        let read = match control {
            ControlTurn::Held | ControlTurn::Skipped => 1,
            ControlTurn::Clean | ControlTurn::Noisy => self.branches.len(),
        };
        let pass = self.pass_index(inputs);
        let pass = &mut self.passes[pass];
        for (i, branch) in self.branches.iter_mut().enumerate().take(read) {
            rec.copy(&pass.logits, i * len, &mut branch.logits, 0, len)?;
        }
        if let ([marked, control], true) = (self.branches.as_mut_slice(), control != ControlTurn::Held) {
            rec.copy(&marked.logits, 0, &mut self.scratch_logits, 0, len)?;
            axpy::forward(rec, -1.0, &self.scratch_logits, &control.logits, &mut marked.logits)?;
        }
        let repeats = config.control_every() as f32;
        for (i, branch) in self.branches.iter_mut().enumerate().take(read) {
            let message = (self.objective, config.objective.lambda_msg);
            let (objective, weight) = match (i, config.extractor.joint()) {
                (0, _) | (_, None) => message,
                (_, Some(JointConfig { control, lambda_control, .. })) => {
                    (control.objective(), message.1 * lambda_control * repeats)
                }
            };
            let answers = Answers { groups, logits: &branch.logits, target: &self.target };
            bce::forward(rec, objective, &answers, &mut branch.value)?;
            bce::backward(rec, objective, weight, &answers, &branch.value, &mut branch.v_logits)?;
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
        buffers: &mut TrainingBuffers,
        clip: &TrainingClip,
        config: &EmbedConfig,
        inputs: StepInputs,
    ) -> Result<(), EngineError> {
        buffers.backward(rec, clip, &self.features.v_x, inputs.distortion)?;
        let (training, weight) = (self.training_in(inputs), config.objective.lambda_offset);
        let offsets = &mut buffers.offsets;
        if weight > 0.0 {
            let term = Term { values: &mut self.fidelity.values, slot: OFFSET, weight, accumulate: Accumulate::Add };
            StepPart::Losses.record(rec, |rec| offsets.add_penalty(rec, term))?;
        }
        StepPart::Optimiser.record(rec, |rec| {
            offsets.step(rec, config, inputs.decay, inputs.offset_scale)?;
            if let (Training::Tmsd, Some(tmsd), Some(joint)) =
                (training, self.features.tmsd(), config.extractor.joint())
            {
                tmsd.step(rec, &AdamConfig { lr: joint.lr_tmsd * inputs.decay, ..AdamConfig::default() })?;
            }
            Ok(())
        })
    }

    /// Copies what the host reads of a step into one buffer.
    fn gather(&mut self, rec: &mut Recorder) -> Result<(), KernelError> {
        rec.copy(&self.fidelity.values, 0, &mut self.report, 0, NUM_VALUES)?;
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

    fn report(&self, config: &EmbedConfig, inputs: StepInputs) -> Result<StepReport, KernelError> {
        let (read, objective) = (self.report.read()?, &config.objective);
        let (values, rest) = read.split_at(NUM_VALUES);
        let (losses, logits) = rest.split_at(self.branches.len());
        let marked = &logits[..self.branches[0].logits.len()];
        let (control, lambda_control) = match (self.control(inputs), config.extractor.joint()) {
            (ControlTurn::Clean | ControlTurn::Noisy, Some(joint)) => {
                let loss = joint.control.objective();
                (losses[1..].iter().fold(0.0, |sum, v| sum + loss.loss(*v)), joint.lambda_control)
            }
            _ => (0.0, 0.0),
        };
        let recon = match objective.lambda_recon > 0.0 {
            true => (1.0 - objective.lambda_ssim) * values[L1] + objective.lambda_ssim * values[DISSIMILARITY],
            false => 0.0,
        };
        let lpips = match (&self.perception, inputs.crop) {
            (Some(perception), Some(_)) => perception.score(&read[read.len() - perception.values().len()..]),
            _ => 0.0,
        };
        let (message, offset) = (losses[0], values[OFFSET]);
        let total = objective.lambda_msg * (message + lambda_control * control)
            + objective.lambda_recon * recon
            + objective.lpips.as_ref().map_or(0.0, |term| term.lambda * lpips)
            + objective.lambda_offset * offset;
        let bit_accuracy = share_right(marked, &vec![0.0; self.target.len()], &self.message);
        let (mse, key_rotation, held_out) = (values[MSE], None, None);
        Ok(StepReport { message, control, mse, recon, lpips, offset, total, bit_accuracy, key_rotation, held_out })
    }

    /// Reads a clip as it is marked now, and where R is trained as it is without a mark. Forward only, and without a
    /// trace: every buffer that it writes is written anew by the next step before that reads it.
    pub(super) fn read_clip(
        &mut self,
        device: &Device,
        buffers: &mut TrainingBuffers,
        clip: &TrainingClip,
        config: &EmbedConfig,
    ) -> Result<ClipReading, EngineError> {
        let (branches, len) = (self.branches.len(), self.branches[0].logits.len());
        let at = NUM_VALUES + branches;
        let mut rec = device.recorder()?;
        buffers.render(&mut rec, clip)?;
        self.fidelity.record(&mut rec, buffers, clip, config)?;
        if branches > 1 {
            buffers.clean_control(&mut rec, clip)?;
        }
        let all = [buffers.resized(), buffers.control()];
        self.features.forward(&mut rec, &all[..branches])?;
        self.decode(&mut rec, 0)?;
        rec.copy(&self.fidelity.values, 0, &mut self.report, 0, NUM_VALUES)?;
        rec.copy(&self.passes[0].logits, 0, &mut self.report, at, len * branches)?;
        rec.submit()?;
        let read = self.report.read()?;
        let (marked, unmarked) = read[at..at + len * branches].split_at(len);
        Ok(ClipReading { mse: read[MSE], marked: marked.to_vec(), unmarked: unmarked.to_vec() })
    }
}
