//! Embedding: optimising SH offsets so that rendered clips carry the message (Guard4D Sec. 3.3–3.5).

mod checkpoint;
mod clips;
mod config;
mod cost;
mod fit;
mod step;

use std::collections::BTreeMap;
use std::time::Instant;

use glam::Mat4;
use guard4d_kernels::Device;
use guard4d_kernels::loss::ssim::SsimScratch;
use rand_chacha::ChaCha20Rng;

pub use config::{Control, EmbedConfig, Profile};
pub use cost::StepPart;
pub use step::StepReport;

use crate::clip::{Clip, Purpose};
use crate::deform::DeformField;
use crate::error::EngineError;
use crate::render::OffsetBases;
use crate::scene::camera_paths::{Band, Lens};
use crate::scene::gaussians::{CHANNELS, SH_FLOATS};
use crate::scene::{Camera, CameraSet, Model, View};
use crate::train::schedule::cosine;
use crate::watermark::decoder::Decoder;
use crate::watermark::digest::Digest;
use crate::watermark::evidence::ExtractorMode;
use crate::watermark::extractor::{CLIP_FRAMES, ExtractorWeights, FeatureExtractor, Training};
use crate::watermark::key::Key;
use crate::watermark::message::Message;
use crate::watermark::prf::{Purpose as Stream, uniform_below, uniform_unit};
use clips::{ClipBuilder, TrainingClip};
use step::{Critic, Rates, Stage};

/// Weight of the newest step in the running mean of the squared error.
const MSE_SHARE: f32 = 0.2;

/// Training clips that share their times.
const CLIPS_PER_TIMES: usize = 16;

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

/// Whether to go on; asked after every step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Take the next step.
    Continue,
    /// Stop here.
    Stop,
}

/// An embedding under way.
pub struct Embedding<'a> {
    subject: Subject<'a>,
    config: EmbedConfig,
    clips: Vec<TrainingClip>,
    stage: Stage,
    critic: Critic,
    weights: ExtractorWeights,
    /// Hash of an extractor that was given.
    frozen: Option<Digest>,
    mean_mse: Option<f32>,
    keep: f32,
    step: usize,
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
        let Subject { device, clip, key, model, message } = subject;
        let mut seconds = BTreeMap::new();
        let started = Instant::now();
        let side = clip.config().vision_config.image_size;
        let mut stage = Stage::new(device, model, &config, side)?;
        let clips = training_clips(&subject, &config, &mut stage)?;
        seconds.insert("plan".to_owned(), started.elapsed().as_secs_f64());

        let started = Instant::now();
        let (weights, branches, frozen) = match start {
            Start::Fit => (fit::extractor(device, clip, key, &config, &clips, &mut stage)?, config.branches(), None),
            // The control losses say nothing about offsets, and R is not to be trained.
            Start::Frozen(given) => (given.clone(), 1, Some(given.digest(key)?)),
        };
        check_mode(&config, &weights)?;
        let features = FeatureExtractor::new(device, clip, weights.tmsd.as_ref(), branches, Purpose::InputGradient)?;
        let decoder = Decoder::new(device, &weights.calibration.fold(&key.decoder, &key.codes, &key.text_mean))?;
        let critic = Critic::new(device, features, decoder, message, &config)?;
        seconds.insert("fit".to_owned(), started.elapsed().as_secs_f64());
        seconds.insert("train".to_owned(), 0.0);
        Ok(Self {
            subject,
            config,
            clips,
            stage,
            critic,
            weights,
            frozen,
            mean_mse: None,
            keep: 1.0,
            step: 0,
            seconds,
            device_seconds: BTreeMap::new(),
        })
    }

    /// The extractor as it was before the first step: for `joint` the last state that never saw the message.
    #[must_use]
    pub fn fitted(&self) -> &ExtractorWeights {
        &self.weights
    }

    /// Steps taken so far.
    #[must_use]
    pub fn step_number(&self) -> usize {
        self.step
    }

    /// Takes one step; `None` when all are done.
    ///
    /// # Errors
    /// When the device fails, or a loss is not finite.
    pub fn step(&mut self) -> Result<Option<StepReport>, EngineError> {
        if self.step >= self.config.steps {
            return Ok(None);
        }
        let started = Instant::now();
        let config = &self.config;
        let mut rng = self.subject.key.prf().stream(Stream::Embedding, stream_index(config.seed, self.step));
        let index = uniform_below(&mut rng, u32::try_from(self.clips.len()).unwrap_or(u32::MAX)) as usize;
        let (low, high) = config.noise_sigma;
        let rates = Rates {
            decay: cosine(self.step, config.steps, config.lr_floor),
            keep: self.keep,
            sigma: low * (high / low).powf(unit(&mut rng)),
            stream: u32::try_from(self.step).unwrap_or(u32::MAX),
        };
        let (report, timings) =
            self.critic.step(self.subject.device, &mut self.stage, &self.clips[index], config, rates)?;
        if !(report.total.is_finite() && report.mse.is_finite()) {
            let what = format!("loss at step {}", self.step);
            return Err(EngineError::NotFinite { what, got: f64::from(report.total) });
        }
        self.hold_fidelity(report.mse);
        for pass in timings.passes {
            *self.device_seconds.entry(pass.name).or_default() += pass.time.as_secs_f64();
        }
        self.step += 1;
        *self.seconds.entry("train".to_owned()).or_default() += started.elapsed().as_secs_f64();
        Ok(Some(report))
    }

    /// Chooses the factor on the offsets for the next step so that the running squared error stays at the target.
    fn hold_fidelity(&mut self, mse: f32) {
        let EmbedConfig { target_psnr, start_psnr, steps, .. } = self.config;
        // The value was measured before this step's factor took effect.
        let mse = mse * self.keep * self.keep;
        let mean = self.mean_mse.map_or(mse, |mean| mean + MSE_SHARE * (mse - mean));
        let progress = (2.0 * self.step as f32 / steps as f32).min(1.0);
        let allowed = 10f32.powf(-0.1 * (start_psnr + (target_psnr - start_psnr) * progress));
        self.keep = if mean > allowed { (allowed / mean).sqrt() } else { 1.0 };
        self.mean_mse = Some(mean * self.keep * self.keep);
    }

    /// The marked coefficients and the extractor as they are now.
    ///
    /// # Errors
    /// When reading from the device fails.
    pub fn finish(mut self) -> Result<Embedded, EngineError> {
        let offsets = self.stage.offsets.read()?;
        let clean = &self.subject.model.gaussians.sh_coeffs;
        let sh_coeffs = marked(clean, &offsets, self.stage.bases);
        if self.critic.training() == Training::Tmsd
            && let Some(tmsd) = self.critic.features.tmsd()
        {
            self.weights.tmsd = Some(tmsd.weights()?);
            let Subject { device, clip, key, .. } = self.subject;
            let mut features = FeatureExtractor::new(device, clip, self.weights.tmsd.as_ref(), 1, Purpose::Features)?;
            let unmarked = (&self.config, self.clips.as_slice(), &mut self.stage);
            fit::set_zero(device, key, &mut features, &mut self.weights, unmarked)?;
        }
        Ok(Embedded {
            sh_coeffs,
            extractor: self.weights,
            seconds: self.seconds,
            device_seconds: self.device_seconds,
            steps: self.step,
            mse: self.mean_mse.unwrap_or(0.0),
        })
    }
}

/// Refuses an extractor of another mode than the settings ask for.
fn check_mode(config: &EmbedConfig, weights: &ExtractorWeights) -> Result<(), EngineError> {
    if weights.mode == config.mode {
        return Ok(());
    }
    Err(EngineError::Usage {
        what: "mode of the given extractor".to_owned(),
        got: format!("{:?}", weights.mode).to_lowercase(),
        expected: format!("{:?}", config.mode).to_lowercase(),
    })
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

/// Random views over the whole motion.
///
/// A clip of `joint` is one camera that turns at its own pace, because its R learns how neighbouring frames belong
/// together. Without temporal weights to train, each frame gets a view of its own: one step then sees eight views
/// instead of one.
fn training_clips(
    subject: &Subject<'_>,
    config: &EmbedConfig,
    stage: &mut Stage,
) -> Result<Vec<TrainingClip>, EngineError> {
    let model = subject.model;
    let mut field = DeformField::new(subject.device, &model.gaussians, model.deformation.as_ref())?;
    let mut rng = subject.key.prf().stream(Stream::Views, config.seed);
    let size = crate::scene::ImageSize::new(config.size_px.0, config.size_px.1)?;
    let band = Band {
        azimuth_deg: 0.0..=360.0,
        elevation_deg: config.elevation_deg.0..=config.elevation_deg.1,
        radius: config.radius..=config.radius,
        target: glam::Vec3::ZERO,
        lens: Lens { fov_x_rad: config.fov_deg.to_radians(), size },
    };
    let frames = u32::try_from(CLIP_FRAMES).expect("a clip is a handful of frames");
    let per_clip = if config.mode == ExtractorMode::Joint { 1 } else { CLIP_FRAMES };
    let cameras: CameraSet = match per_clip {
        1 => band.sample(config.views, config.seed)?,
        _ => band.sample(config.views * frames, config.seed)?,
    };
    // A few clips share each set of times, so that the deformation is evaluated once for them.
    let mut times = [0.0; CLIP_FRAMES];
    let similarity = match config.uses_ssim() {
        true => Some(SsimScratch::new(subject.device, config.frame_size(), 1)?),
        false => None,
    };
    let mut builder = ClipBuilder {
        device: subject.device,
        field: &mut field,
        renderer: &mut stage.renderer,
        resize: &stage.resize,
        background: stage.background,
        similarity,
    };
    let mut clips = Vec::with_capacity(config.views as usize);
    for (number, views) in cameras.views.chunks(per_clip).enumerate() {
        if number % CLIPS_PER_TIMES == 0 {
            let shift = unit(&mut rng);
            times = std::array::from_fn(|i| (i as f32 + shift) / CLIP_FRAMES as f32);
        }
        let turn = config.turn_deg.to_radians() * (2.0 * uniform_unit(&mut rng) - 1.0);
        let shots: Vec<_> = times.iter().enumerate().map(|(i, &t)| (shot(views, i, turn), t)).collect();
        clips.push(builder.build(&shots)?);
    }
    Ok(clips)
}

/// Camera of frame `i`: a view of its own, or the only one turned `i` times.
#[allow(clippy::cast_possible_truncation, reason = "cameras are single precision")]
fn shot(views: &[View], i: usize, turn_rad: f64) -> Camera {
    match views {
        [one] => {
            let turn = Mat4::from_rotation_z((turn_rad * i as f64) as f32);
            Camera { world_to_camera: one.camera.world_to_camera * turn, ..one.camera }
        }
        several => several[i].camera,
    }
}

/// Every step has a random stream of its own, so that a resumed run draws what an unbroken one would.
fn stream_index(seed: u64, step: usize) -> u64 {
    (seed << 32) | step as u64
}

#[allow(clippy::cast_possible_truncation, reason = "a factor between 0 and 1")]
fn unit(rng: &mut ChaCha20Rng) -> f32 {
    uniform_unit(rng) as f32
}
