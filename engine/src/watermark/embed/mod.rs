//! Embedding: optimising SH offsets so that rendered clips carry the message (Guard4D Sec. 3.3–3.5).

mod audition;
mod checkpoint;
mod climb;
mod clips;
mod config;
mod copies;
mod cost;
mod estimate;
mod fit;
mod ladder;
mod perception;
mod pool;
pub mod pretrain;
mod repeated;
mod step;
mod terms;
mod visibility;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use guard4d_kernels::Device;
use rand_chacha::ChaCha20Rng;

pub use config::{EmbedConfig, Profile};
pub use cost::StepPart;
pub use estimate::Estimate;
pub use ladder::{Aim, Ladder, Left, Look, Rung, RungReport};
pub use repeated::Repetition;
pub use step::{HeldOutReport, StepReport};
pub use terms::{Control, ControlClips, LpipsTerm};
pub use visibility::within_reach;

use crate::clip::{Clip, Purpose};
use crate::error::EngineError;
use crate::render::OffsetBases;
use crate::scene::gaussians::{CHANNELS, SH_FLOATS};
use crate::scene::{Camera, Model};
use crate::watermark::decoder::Decoder;
use crate::watermark::digest::Digest;
use crate::watermark::extractor::{ExtractorWeights, FeatureExtractor, Training};
use crate::watermark::key::Key;
use crate::watermark::message::Message;
use crate::watermark::prf::{Purpose as Stream, uniform_below, uniform_unit};
use audition::Audition;
use ladder::Standing;
use pool::{ClipPool, is_over_budget};
use step::{Critic, Rates, Stage};

/// Weight of the newest step in the running mean of the squared error.
const MSE_SHARE: f32 = 0.2;

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
    /// Steps taken.
    pub steps: usize,
    /// What held-out clips showed meanwhile.
    pub looks: Vec<Look>,
    /// What each rung of the ladder bought, where there was one.
    pub rungs: Vec<RungReport>,
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

/// What an embedding works on.
#[derive(Clone, Copy, Debug)]
pub struct Subject<'a> {
    /// Device.
    pub device: &'a Device,
    /// Frozen CLIP.
    pub clip: &'a Clip,
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

/// An embedding under way.
pub struct Embedding<'a> {
    subject: Subject<'a>,
    config: EmbedConfig,
    /// The settings on the rung that it stands on.
    active: EmbedConfig,
    clips: ClipPool,
    stage: Stage,
    critic: Critic,
    weights: ExtractorWeights,
    /// Hash of an extractor that was given.
    frozen: Option<Digest>,
    mean_mse: Option<f32>,
    keep: f32,
    step: usize,
    /// Mixings still to be tried, before the first step.
    audition: Option<Audition>,
    /// Visible weight of the splats, where it decides what moves.
    light: Option<Vec<f64>>,
    /// How far up the ladder it is.
    standing: Standing,
    seconds: BTreeMap<String, f64>,
    device_seconds: BTreeMap<&'static str, f64>,
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
        let clips = ClipPool::draw(subject.device, subject.model, &subject.key.prf(), &config)?;
        Self::prepare_on(subject, config, start, clips)
    }

    /// The same on these clips.
    fn prepare_on(
        subject: Subject<'a>,
        config: EmbedConfig,
        start: Start<'_>,
        mut clips: ClipPool,
    ) -> Result<Self, EngineError> {
        let Subject { device, clip, key, model, .. } = subject;
        if let Some(general) = &config.general {
            general.check_key(key)?;
        }
        let config = config.for_degree(model.gaussians.sh_degree);
        let mut seconds = BTreeMap::new();
        let started = Instant::now();
        let side = clip.config().vision_config.image_size;
        let active = config.on_rung(0);
        let mut stage = Stage::new(device, model, &active, side)?;
        clips.fill(&mut stage)?;
        seconds.insert("plan".to_owned(), started.elapsed().as_secs_f64());

        let started = Instant::now();
        let (weights, branches, frozen, audition) = match start {
            Start::Fit => {
                let (fitted, unmarked) = fit::extractor(device, clip, key, &config, &mut clips, &mut stage)?;
                let audition = (config.mixings > 1).then(|| Audition::new(fitted.calibration.clone(), unmarked));
                (fitted, config.branches(), None, audition)
            }
            // The control losses say nothing about offsets, and R is not to be trained.
            Start::Frozen(given) => (given.clone(), 1, Some(given.digest(key)?), None),
        };
        check_mode(&config, &weights)?;
        let light = match config.rates_differ() {
            true => Some(visibility::weights(device, &mut clips, &mut stage)?),
            false => None,
        };
        let critic = critic(&subject, &config, (&weights, branches), &mut clips)?;
        seconds.insert("fit".to_owned(), started.elapsed().as_secs_f64());
        seconds.insert("train".to_owned(), 0.0);
        let mut embedding = Self {
            subject,
            config,
            active,
            clips,
            stage,
            critic,
            weights,
            frozen,
            mean_mse: None,
            keep: 1.0,
            step: 0,
            audition,
            light,
            standing: Standing::default(),
            seconds,
            device_seconds: BTreeMap::new(),
        };
        embedding.take_rung()?;
        Ok(embedding)
    }

    /// The extractor as it was before the first step, for `joint` the last state that never saw the message; before mixings are tried, with the
    /// first of them.
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
        let tried = match &self.audition {
            Some(audition) => audition.taken(),
            None => self.config.try_out_steps(),
        };
        (tried + self.step, self.config.try_out_steps() + self.config.steps)
    }

    /// Takes one step; `None` when all are done. Those of the try-outs of mixings come first.
    ///
    /// # Errors
    /// When the device fails, or a loss is not finite.
    pub fn step(&mut self) -> Result<Option<StepReport>, EngineError> {
        let (started, rung) = (Instant::now(), self.standing.rung);
        if let Some(audition) = self.audition.take() {
            let report = self.try_out(audition)?;
            *self.seconds.entry("fit".to_owned()).or_default() += started.elapsed().as_secs_f64();
            return Ok(Some(report));
        }
        if self.step >= self.standing.steps(&self.config) {
            return Ok(None);
        }
        let mut report = self.advance(self.step, self.standing.decay(&self.active, self.step))?;
        self.step += 1;
        if self.is_measured() {
            report.held_out = self.held_out()?;
        }
        self.add_seconds(rung, started);
        if let Some(held_out) = &report.held_out {
            let started = Instant::now();
            self.look(held_out)?;
            self.add_seconds(self.standing.rung, started);
        }
        Ok(Some(report))
    }

    /// What step number `step` does to the offsets and to R, with this share of the rates.
    fn advance(&mut self, step: usize, decay: f32) -> Result<StepReport, EngineError> {
        let config = &self.active;
        let (index, mut rng) = draw(self.subject.key, config.seed, step, self.clips.training().len());
        let clip = self.critic.clip(&mut self.clips, &mut self.stage, index)?;
        let (low, high) = config.noise_sigma;
        let sigma = low * (high / low).powf(unit(&mut rng));
        let rates = Rates {
            decay,
            keep: self.keep,
            sigma,
            stream: u32::try_from(step).unwrap_or(u32::MAX),
            control: config.control_turn(step),
            lpips: config.lpips_turn(step, &mut rng),
            distortion: config.distortion_turn(step, &mut rng),
        };
        if let Some(perception) = self.critic.perception.as_mut().filter(|_| rates.lpips.is_some()) {
            perception.make_room(self.subject.device, &self.clips, &clip)?;
        }
        let (report, timings) = self.critic.step(self.subject.device, &mut self.stage, &clip, config, rates)?;
        if !(report.total.is_finite() && report.mse.is_finite()) {
            let what = format!("loss at step {step}");
            return Err(EngineError::NotFinite { what, got: f64::from(report.total) });
        }
        self.hold_fidelity(step, report.mse);
        for pass in timings.passes {
            *self.device_seconds.entry(pass.name).or_default() += pass.time.as_secs_f64();
        }
        Ok(report)
    }

    /// Chooses how the passes that are the same in every step come to the device, from the next step on.
    pub fn repeat(&mut self, how: Repetition) {
        self.critic.repeated.how = how;
    }

    /// Host time of recording the last step, before anything of it ran.
    #[must_use]
    pub fn recording_time(&self) -> Duration {
        self.critic.repeated.last_step
    }

    /// Counts the time since `started` as training's, and as that of a rung.
    fn add_seconds(&mut self, rung: usize, started: Instant) {
        let seconds = started.elapsed().as_secs_f64();
        *self.seconds.entry("train".to_owned()).or_default() += seconds;
        if self.config.ladder.is_some() {
            *self.seconds.entry(format!("train on rung {}", rung + 1)).or_default() += seconds;
        }
    }

    /// Whether the step just taken is one whose result is measured on held-out clips.
    fn is_measured(&self) -> bool {
        let is_last = self.step == self.standing.steps(&self.config);
        match (&self.config.ladder, self.config.held_out_every) {
            (Some(ladder), _) => is_last || self.standing.is_look(ladder, self.step),
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
        self.critic.measure(self.subject.device, &mut self.stage, &mut self.clips, &self.config).map(Some)
    }

    /// Light that each splat has in the training clips `[N]`: the sum over pixels and frames of its share in them, by the
    /// colour channel that lets most through. At most the first 32 clips are summed.
    ///
    /// # Errors
    /// When the device fails, or the sum is not a number.
    pub fn visible_weight(&mut self) -> Result<Vec<f64>, EngineError> {
        visibility::weights(self.subject.device, &mut self.clips, &mut self.stage)
    }

    /// Cameras and times of the clips that steps are taken on for now.
    pub fn training_shots(&self) -> impl Iterator<Item = &[(Camera, f32)]> {
        self.clips.shots(self.clips.training())
    }

    /// Cameras and times of the clips that no step is taken on.
    pub fn held_out_shots(&self) -> impl Iterator<Item = &[(Camera, f32)]> {
        self.clips.shots(self.clips.held_out())
    }

    /// Chooses the factor on the offsets for the next step so that the running squared error stays at the target.
    fn hold_fidelity(&mut self, step: usize, mse: f32) {
        let EmbedConfig { target_psnr, start_psnr, steps, .. } = self.config;
        // The value was measured before this step's factor took effect.
        let mse = mse * self.keep * self.keep;
        let mean = self.mean_mse.map_or(mse, |mean| mean + MSE_SHARE * (mse - mean));
        let progress = (2.0 * step as f32 / steps as f32).min(1.0);
        let allowed = 10f32.powf(-0.1 * (start_psnr + (target_psnr - start_psnr) * progress));
        self.keep = if mean > allowed { (allowed / mean).sqrt() } else { 1.0 };
        self.mean_mse = Some(mean * self.keep * self.keep);
    }

    /// The marked coefficients and the extractor as they are now.
    ///
    /// # Errors
    /// When reading from the device fails.
    pub fn finish(self) -> Result<Embedded, EngineError> {
        let Self { subject, config, mut clips, mut stage, mut critic, mut weights, .. } = self;
        let offsets = stage.offsets.read()?;
        let sh_coeffs = marked(&subject.model.gaussians.sh_coeffs, &offsets, stage.bases);
        let trained = match critic.training() {
            Training::Tmsd => critic.features.tmsd().map(|tmsd| tmsd.weights()).transpose()?,
            Training::Frozen => None,
        };
        // A loss is looked at before its step, so that the last one could leave what no loss has told of.
        check_finite("offsets", &offsets)?;
        for layer in trained.iter().flat_map(|tmsd| &tmsd.layers) {
            check_finite("weights of R", layer)?;
        }
        let recomputed = critic.features.recomputes();
        // Its memory is more than what follows takes.
        drop(critic);
        if trained.is_some() {
            weights.tmsd = trained;
            let Subject { device, clip, key, .. } = subject;
            let tmsd = weights.tmsd.as_ref();
            let mut features = clips.with_room(|| FeatureExtractor::new(device, clip, tmsd, 1, Purpose::Features))?;
            let unmarked = fit::unmarked_features(device, &mut features, (&config, &mut clips, &mut stage))?;
            clips.with_room(|| fit::set_zero(device, key, &mut weights.calibration, &unmarked))?;
            check_finite("mean logits of unmarked clips", &weights.calibration.mean_logits)?;
        }
        Ok(Embedded {
            sh_coeffs,
            extractor: weights,
            seconds: self.seconds,
            device_seconds: self.device_seconds,
            steps: self.step,
            looks: self.standing.looks,
            rungs: self.standing.reports,
            clips_made: clips.made(),
            recomputed,
            mse: self.mean_mse.unwrap_or(0.0),
        })
    }
}

/// The extractor ready for training. Activations that the backward pass can compute again are kept where the memory budget
/// has room for them beside one clip.
fn critic(
    subject: &Subject<'_>,
    config: &EmbedConfig,
    (weights, branches): (&ExtractorWeights, usize),
    clips: &mut ClipPool,
) -> Result<Critic, EngineError> {
    let Subject { device, clip, key, message, .. } = *subject;
    let make = |purpose| {
        let mut features = FeatureExtractor::new(device, clip, weights.tmsd.as_ref(), branches, purpose)?;
        if config.goes_without_control() {
            features.make_room_for_one(device)?;
        }
        Critic::new(device, features, critic_decoder(device, key, weights)?, message, config)
    };
    let kept = clips.with_room_beside_one(|| make(Purpose::InputGradient));
    if !is_over_budget(&kept) {
        return kept;
    }
    tracing::debug!("activations are computed again on the way back");
    clips.with_room(|| make(Purpose::LeanInputGradient))
}

/// The key's decoder as it reads image features.
fn critic_decoder(device: &Device, key: &Key, weights: &ExtractorWeights) -> Result<Decoder, EngineError> {
    Ok(Decoder::new(device, &weights.calibration.fold(&key.decoder, &key.codes, &key.text_mean))?)
}

/// Refuses an extractor of another mode than the settings ask for.
fn check_mode(config: &EmbedConfig, weights: &ExtractorWeights) -> Result<(), EngineError> {
    if weights.mode == config.mode {
        return Ok(());
    }
    Err(EngineError::Usage {
        what: "mode of the given extractor".to_owned(),
        got: weights.mode.to_string(),
        expected: config.mode.to_string(),
    })
}

/// Refuses to hand out what is no number.
fn check_finite(what: &str, values: &[f32]) -> Result<(), EngineError> {
    match values.iter().find(|v| !v.is_finite()) {
        None => Ok(()),
        Some(value) => Err(EngineError::NotFinite { what: what.to_owned(), got: f64::from(*value) }),
    }
}

/// Coefficients plus offsets; those with an offset of zero keep their bits, also those of a negative zero.
fn marked(clean: &[f32], offsets: &[f32], bases: OffsetBases) -> Vec<f32> {
    let mut marked = clean.to_vec();
    for (splat, row) in marked.chunks_exact_mut(SH_FLOATS).zip(offsets.chunks_exact(bases.floats())) {
        for (h, d) in splat.iter_mut().zip(&row[..CHANNELS * bases.count()]).filter(|(_, d)| **d != 0.0) {
            *h += d;
        }
    }
    marked
}

/// The clip that a step is taken on, by its number among so many, and the stream of all else that the step draws.
fn draw(key: &Key, seed: u64, step: usize, clips: usize) -> (usize, ChaCha20Rng) {
    let mut rng = key.prf().stream(Stream::Embedding, stream_index(seed, step));
    let index = uniform_below(&mut rng, u32::try_from(clips).unwrap_or(u32::MAX));
    (index as usize, rng)
}

/// Every step has a random stream of its own, so that a resumed run draws what an unbroken one would.
fn stream_index(seed: u64, step: usize) -> u64 {
    (seed << 32) | step as u64
}

#[allow(clippy::cast_possible_truncation, reason = "a factor between 0 and 1")]
fn unit(rng: &mut ChaCha20Rng) -> f32 {
    uniform_unit(rng) as f32
}
