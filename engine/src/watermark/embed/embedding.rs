//! Embedding: optimising SH offsets so that rendered clips carry the message (Guard4D Sec. 3.3–3.5).

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use guard4d_kernels::Device;
use guard4d_kernels::shape::ClipShape;

use super::buffers::TrainingBuffers;
use super::config::{EmbedConfig, Extractor, FramingChoice};
use super::draw::{draw, window};
use super::extractor_loss::ExtractorLoss;
use super::fidelity_hold::FidelityHold;
use super::fit::{self, Fitted};
use super::fit_context::FitContext;
use super::foretold::{Foretold, TakenOff};
use super::pool::{ClipPool, is_out_of_memory};
use super::progress::Progress;
use super::repeated::Repetition;
use super::report::{HeldOutReport, StepReport};
use super::rotation_search::RotationSearch;
use super::step_inputs::StepInputs;
use super::subject::{Embedded, Start, Subject};
use super::{held_out, visibility};
use crate::base::digest::Digest;
use crate::error::EngineError;
use crate::networks::clip::TowerPurpose;
use crate::scene::Camera;
use crate::watermark::extractor::content::ContentModel;
use crate::watermark::extractor::features::{FeatureExtractor, Training};
use crate::watermark::extractor::weights::{CLIP_FRAMES, ExtractorWeights};
use crate::watermark::key::decoder::Decoder;
use crate::watermark::key::owner_key::Key;
use crate::watermark::step_part::{StepPart, StepSeconds};

/// An embedding under way.
pub struct Embedding<'a> {
    pub(super) subject: Subject<'a>,
    pub(super) config: EmbedConfig,
    /// The settings in the phase that it is in.
    pub(super) active: EmbedConfig,
    pub(super) clips: ClipPool,
    pub(super) buffers: TrainingBuffers,
    pub(super) loss: ExtractorLoss,
    pub(super) weights: ExtractorWeights,
    /// Hash of an extractor that was given.
    pub(super) frozen: Option<Digest>,
    pub(super) hold: FidelityHold,
    pub(super) step: usize,
    /// Rotations still to be tried, before the first step.
    pub(super) search: Option<RotationSearch>,
    /// Visibility of the splats, where it decides what moves.
    pub(super) visibility: Option<Vec<f64>>,
    /// How far it is in its schedule.
    pub(super) progress: Progress,
    pub(super) seconds: BTreeMap<String, f64>,
    device_seconds: StepSeconds,
}

impl<'a> Embedding<'a> {
    /// Plans the training clips and fits the message-blind parts of the extractor.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for impossible settings; when memory runs out or the device fails.
    pub fn prepare(subject: Subject<'a>, config: EmbedConfig) -> Result<Self, EngineError> {
        config.validate_for(subject.key.bits())?;
        Self::prepare_with(subject, config, Start::Fit)
    }

    /// The same with a choice of extractor.
    ///
    /// # Errors
    /// As [`Embedding::prepare`]; [`EngineError::Usage`] for a frozen extractor of another mode than the settings'.
    pub fn prepare_with(subject: Subject<'a>, config: EmbedConfig, start: Start<'_>) -> Result<Self, EngineError> {
        config.validate()?;
        // An extractor that is given has been fitted to frames that are cut in its own way.
        let config = match start {
            Start::Frozen(given) => config.with(|config| {
                let is_framed = given.known_views.is_some();
                config.views.framing = if is_framed { FramingChoice::Known } else { FramingChoice::Whole };
            }),
            _ => config,
        };
        let clips = ClipPool::draw(subject.device, subject.model, &subject.key.prf(), &config)?;
        Self::prepare_on(subject, config, start, clips)
    }

    /// The same on these clips.
    pub(super) fn prepare_on(
        subject: Subject<'a>,
        config: EmbedConfig,
        start: Start<'_>,
        mut clips: ClipPool,
    ) -> Result<Self, EngineError> {
        let Subject { device, clip, key, model, .. } = subject;
        if let Extractor::Pretrained(pretrained) = &config.extractor {
            pretrained.weights.get()?.check_key(key)?;
        }
        let config = config.for_degree(model.gaussians.sh_degree);
        let mut seconds = BTreeMap::new();
        let started = Instant::now();
        let side = clip.config().vision_config.image_size;
        let active = config.in_phase(0);
        let mut buffers = TrainingBuffers::new(device, model, &active, side)?;
        clips.fill(&mut buffers)?;
        seconds.insert("plan".to_owned(), started.elapsed().as_secs_f64());

        let started = Instant::now();
        let mut chosen = Chosen::from(&subject, &config, start, &mut clips, &mut buffers)?;
        check_mode(&config, &chosen.weights)?;
        let visibility = match config.rates_differ() {
            true => Some(visibility::measure(device, &mut clips, &mut buffers)?),
            false => None,
        };
        let loss = extractor_loss(&subject, &config, &mut chosen, &mut clips)?;
        seconds.insert("fit".to_owned(), started.elapsed().as_secs_f64());
        seconds.insert("train".to_owned(), 0.0);
        let Chosen { weights, frozen, search, .. } = chosen;
        let mut embedding = Self {
            subject,
            config,
            active,
            clips,
            buffers,
            loss,
            weights,
            frozen,
            hold: FidelityHold::default(),
            step: 0,
            search,
            visibility,
            progress: Progress::default(),
            seconds,
            device_seconds: StepSeconds::default(),
        };
        embedding.take_phase()?;
        Ok(embedding)
    }

    /// The extractor as it was before the first step, for `joint` the last state that never saw the message; before
    /// rotations are tried, with the first of them.
    #[must_use]
    pub fn fitted(&self) -> &ExtractorWeights {
        &self.weights
    }

    /// Steps taken so far.
    #[must_use]
    pub fn step_number(&self) -> usize {
        self.step
    }

    /// Steps taken so far with those of the try-outs, and how many there are at most.
    #[must_use]
    pub fn progress(&self) -> (usize, usize) {
        let tried = match &self.search {
            Some(search) => search.taken(),
            None => self.config.try_out_steps(),
        };
        (tried + self.step, self.config.try_out_steps() + self.config.optimiser.steps)
    }

    /// Takes one step; `None` when all are done. Those of the try-outs of rotations come first.
    ///
    /// # Errors
    /// When the device fails, or a loss is not finite.
    pub fn step(&mut self) -> Result<Option<StepReport>, EngineError> {
        let (started, phase) = (Instant::now(), self.progress.phase);
        if let Some(search) = self.search.take() {
            let report = self.try_rotation(search)?;
            *self.seconds.entry("fit".to_owned()).or_default() += started.elapsed().as_secs_f64();
            return Ok(Some(report));
        }
        if self.step >= self.progress.steps(&self.config) {
            return Ok(None);
        }
        let mut report = self.take_step(self.step, self.progress.decay(&self.active, self.step))?;
        self.step += 1;
        if self.is_measured() {
            report.held_out = self.held_out()?;
        }
        self.add_seconds(phase, started);
        if let Some(held_out) = &report.held_out {
            let started = Instant::now();
            self.note(held_out)?;
            self.add_seconds(self.progress.phase, started);
        }
        Ok(Some(report))
    }

    /// What step number `step` does to the offsets and to R, with this share of the rates.
    pub(super) fn take_step(&mut self, step: usize, decay: f32) -> Result<StepReport, EngineError> {
        let Self { subject, active: config, clips, buffers, loss, .. } = self;
        let among = window(step, config.optimiser.steps, clips.training().len());
        let (index, mut rng) = draw(subject.key, config.seed, step, among);
        let clip = loss.clip(clips, buffers, index)?;
        let inputs = StepInputs::draw(config, step, decay, self.hold.offset_scale, &mut rng);
        loss.foretell(subject.device, buffers, index, &clip)?;
        loss.make_room(subject.device, clips, &clip, inputs)?;
        let (report, timings) = loss.step(subject.device, buffers, &clip, config, inputs)?;
        if !(report.total.is_finite() && report.mse.is_finite()) {
            let what = format!("loss at step {step}");
            return Err(EngineError::NotFinite { what, got: f64::from(report.total) });
        }
        self.hold.note(&self.config, step, report.mse);
        self.device_seconds.add(&timings);
        Ok(report)
    }

    /// Chooses how the passes that are the same in every step come to the device, from the next step on.
    pub fn repeat(&mut self, how: Repetition) {
        self.loss.repeat(how);
    }

    /// Host time of recording the last step, before anything of it ran.
    #[must_use]
    pub fn recording_time(&self) -> Duration {
        self.loss.recording_time()
    }

    /// Counts the time since `started` as training's, and as that of a phase.
    fn add_seconds(&mut self, phase: usize, started: Instant) {
        let seconds = started.elapsed().as_secs_f64();
        *self.seconds.entry("train".to_owned()).or_default() += seconds;
        if self.config.schedule.is_some() {
            *self.seconds.entry(format!("train in phase {}", phase + 1)).or_default() += seconds;
        }
    }

    /// Whether the step just taken is one whose result is measured on held-out clips.
    fn is_measured(&self) -> bool {
        let is_last = self.step == self.progress.steps(&self.config);
        match (&self.config.schedule, self.config.optimiser.held_out_every) {
            (Some(schedule), _) => is_last || self.progress.is_evaluated(schedule, self.step),
            (None, 0) => false,
            (None, every) => is_last || self.step.is_multiple_of(every),
        }
    }

    /// What the mark, as it is now, is worth on the held-out clips; `None` when there are none.
    ///
    /// # Errors
    /// When the device fails, or a figure is not a number.
    pub fn held_out(&mut self) -> Result<Option<HeldOutReport>, EngineError> {
        if self.clips.held_out().is_empty() {
            return Ok(None);
        }
        let Self { subject, loss, buffers, clips, config, .. } = self;
        held_out::evaluate(subject.device, loss, buffers, clips, config).map(Some)
    }

    /// Visibility of each splat in the training clips `[N]`: the sum over pixels and frames of its share in them, by
    /// the colour channel that lets most through. At most the first 32 clips are summed.
    ///
    /// # Errors
    /// When the device fails, or the sum is not a number.
    pub fn visibility(&mut self) -> Result<Vec<f64>, EngineError> {
        visibility::measure(self.subject.device, &mut self.clips, &mut self.buffers)
    }

    /// Cameras and times of the clips that steps are taken on for now.
    pub fn training_shots(&self) -> impl Iterator<Item = &[(Camera, f32)]> {
        self.clips.shots(self.clips.training())
    }

    /// Cameras and times of the clips that no step is taken on.
    pub fn held_out_shots(&self) -> impl Iterator<Item = &[(Camera, f32)]> {
        self.clips.shots(self.clips.held_out())
    }

    /// The marked coefficients and the extractor as they are now.
    ///
    /// # Errors
    /// When reading from the device fails.
    pub fn finish(self) -> Result<Embedded, EngineError> {
        let Self { subject, config, mut clips, mut buffers, mut loss, mut weights, .. } = self;
        let offsets = buffers.offsets.read()?;
        let sh_coeffs = buffers.offsets.added_to(&subject.model.gaussians.sh_coeffs, &offsets);
        let trained = match loss.training() {
            Training::Tmsd => loss.tmsd().map(|tmsd| tmsd.weights()).transpose()?,
            Training::Frozen => None,
        };
        // A loss is looked at before its step, so that the last one could leave what no loss has told of.
        check_finite("offsets", &offsets)?;
        for layer in trained.iter().flat_map(|tmsd| &tmsd.layers) {
            check_finite("weights of R", layer)?;
        }
        let recomputed = loss.recomputes();
        // Its memory is more than what follows takes.
        drop(loss);
        if trained.is_some() {
            weights.tmsd = trained;
            let Subject { device, clip, key, .. } = subject;
            let tmsd = weights.tmsd.as_ref();
            let mut features =
                clips.with_room(|| FeatureExtractor::new(device, clip, tmsd, 1, TowerPurpose::Features))?;
            let (config, prf, pool, buffers) = (&config, &key.prf(), &mut clips, &mut buffers);
            let mut context = FitContext { device, config, prf, pool, buffers };
            let unmarked = fit::unmarked_features(&mut context, &mut features, None)?;
            clips.with_room(|| fit::set_zero(device, key, &mut weights.calibration, &unmarked))?;
            check_finite("mean logits of unmarked clips", &weights.calibration.mean_logits)?;
        }
        Ok(Embedded {
            sh_coeffs,
            extractor: weights,
            seconds: self.seconds,
            part_seconds: self.device_seconds.parts(),
            device_seconds: self.device_seconds.kernels,
            steps: self.step,
            evaluations: self.progress.evaluations,
            phases: self.progress.phases,
            clips_made: clips.made(),
            recomputed,
            mse: self.hold.mean_mse.unwrap_or(0.0),
        })
    }

    /// Device seconds of the steps so far by part; parts that took none are 0.
    #[must_use]
    pub fn part_seconds(&self) -> BTreeMap<StepPart, f64> {
        self.device_seconds.parts()
    }
}

/// The extractor that an embedding goes through, and how.
struct Chosen {
    weights: ExtractorWeights,
    /// Clips that it reads in a step.
    branches: usize,
    /// Its hash, if it was given.
    frozen: Option<Digest>,
    /// Rotations to be tried.
    search: Option<RotationSearch>,
    /// What clips are foretold to say unmarked.
    foretold: Option<Foretold>,
}

impl Chosen {
    fn from(
        subject: &Subject<'_>,
        config: &EmbedConfig,
        start: Start<'_>,
        pool: &mut ClipPool,
        buffers: &mut TrainingBuffers,
    ) -> Result<Self, EngineError> {
        let Subject { device, clip, key, .. } = *subject;
        match start {
            Start::Fit => {
                let prf = &key.prf();
                let mut context = FitContext { device, config, prf, pool, buffers };
                let Fitted { weights, unmarked, foretold } = fit::extractor(&mut context, clip, key)?;
                let of = config.extractor.rotations();
                let search = (of > 1).then(|| RotationSearch::new(of, weights.calibration.clone(), unmarked));
                Ok(Self { weights, branches: config.branches(), frozen: None, search, foretold })
            }
            // The control losses say nothing about offsets, and R is not to be trained.
            Start::Frozen(given) => {
                let side = clip.config().vision_config.image_size;
                let seen = ClipShape { frames: CLIP_FRAMES, height: side, width: side };
                let by = |model: &Arc<ContentModel>| Foretold::by(device, seen, Arc::clone(model));
                let foretold = given.content.as_ref().map(by).transpose()?;
                let frozen = Some(given.digest(key)?);
                Ok(Self { weights: given.clone(), branches: 1, frozen, search: None, foretold })
            }
        }
    }
}

/// The extractor ready for training. Activations that the backward pass can compute again are kept where the memory
/// budget has room for them beside one clip.
fn extractor_loss(
    subject: &Subject<'_>,
    config: &EmbedConfig,
    chosen: &mut Chosen,
    clips: &mut ClipPool,
) -> Result<ExtractorLoss, EngineError> {
    let Subject { device, clip, key, message, .. } = *subject;
    let foretold = chosen.foretold.take();
    let Chosen { weights, branches, .. } = chosen;
    let make = |purpose| {
        let mut features = FeatureExtractor::new(device, clip, weights.tmsd.as_ref(), *branches, purpose)?;
        if config.goes_without_control() {
            features.make_room_for_one(device)?;
        }
        ExtractorLoss::new(device, features, folded_decoder(device, key, weights)?, message, config)
    };
    let kept = clips.with_room_beside_one(|| make(TowerPurpose::InputGradient));
    let mut loss = if is_out_of_memory(&kept) {
        tracing::debug!("activations are computed again on the way back");
        clips.with_room(|| make(TowerPurpose::LeanInputGradient))?
    } else {
        kept?
    };
    if let Some(foretold) = foretold {
        loss.take_off(TakenOff::new(device, clips, foretold, CLIP_FRAMES * key.text_mean.len())?);
    }
    Ok(loss)
}

/// The key's decoder as it reads image features.
pub(super) fn folded_decoder(device: &Device, key: &Key, weights: &ExtractorWeights) -> Result<Decoder, EngineError> {
    Ok(Decoder::new(device, &weights.calibration.fold(&key.decoder, &key.codes, &key.text_mean))?)
}

/// Refuses an extractor of another mode than the settings ask for.
fn check_mode(config: &EmbedConfig, weights: &ExtractorWeights) -> Result<(), EngineError> {
    if weights.mode == config.mode() {
        return Ok(());
    }
    Err(EngineError::Usage {
        what: "mode of the given extractor".to_owned(),
        got: weights.mode.to_string(),
        expected: config.mode().to_string(),
    })
}

/// Refuses to hand out what is no number.
fn check_finite(what: &str, values: &[f32]) -> Result<(), EngineError> {
    match values.iter().find(|v| !v.is_finite()) {
        None => Ok(()),
        Some(value) => Err(EngineError::NotFinite { what: what.to_owned(), got: f64::from(*value) }),
    }
}
