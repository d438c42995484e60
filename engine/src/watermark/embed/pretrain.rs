//! Making a pretrained extractor: what moves image features behind a scene's own colour map, summed over many scenes.
//!
//! Each scene brings random offsets, which are random messages to whatever reads them, and the clips and copies that
//! these have to be told from. No owner's key, message or scene takes part, so that what comes out is the same for all
//! owners.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

use guard4d_kernels::Device;
use serde::{Deserialize, Serialize};

use super::buffers::TrainingBuffers;
use super::config::{EmbedConfig, FramingChoice, Profile};
use super::fit::{self, Seen};
use super::fit_context::FitContext;
use super::pool::ClipPool;
use crate::base::digest::Digest;
use crate::base::matrix::row_major;
use crate::base::output::{AtomicFile, Existing};
use crate::base::prf::{MasterSecret, Prf, Purpose};
use crate::base::tensor_file::TensorFile;
use crate::error::EngineError;
use crate::evidence::extractor_mode::ExtractorMode;
use crate::networks::clip::{ClipModel, TowerPurpose};
use crate::scene::{Model, procedural};
use crate::watermark::extractor::features::FeatureExtractor;
use crate::watermark::extractor::pretrained::PretrainedExtractor;
use crate::watermark::extractor::scatter::Scatter;
use crate::watermark::extractor::tmsd::{SAME_COLOURS, TmsdConfig, TmsdWeights};
use crate::watermark::key::owner_key::digest_of;

/// `format` entry of a checkpoint.
const FORMAT: &str = "guard4d.pretraining/1";
/// Bits of the messages that the curve is about, unless the extractor has fewer.
const CURVE_BITS: usize = 16;

/// Scenes to learn from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub enum Scenery {
    /// So many that are made of random numbers.
    Procedural(u32),
    /// A model.
    Path(PathBuf),
}

/// `procedural:N` or a path.
impl FromStr for Scenery {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        let Some(number) = text.strip_prefix("procedural:") else { return Ok(Self::Path(PathBuf::from(text))) };
        let bad = |_| EngineError::Usage {
            what: "scenes".to_owned(),
            got: text.to_owned(),
            expected: "procedural:N with a whole number, or the path of a model".to_owned(),
        };
        number.parse().map(Self::Procedural).map_err(bad)
    }
}

/// The last part of a path.
impl fmt::Display for Scenery {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Procedural(number) => write!(f, "procedural:{number}"),
            Self::Path(path) => write!(f, "{}", path.file_name().unwrap_or(path.as_os_str()).to_string_lossy()),
        }
    }
}

/// What a pretrained extractor is made from.
#[derive(Clone, Debug, Serialize)]
pub struct PretrainConfig {
    /// Most bits of a message.
    pub bits: usize,
    /// Public seed of scenes, views and offsets.
    pub seed: u64,
    /// Scenes.
    pub scenes: Vec<Scenery>,
    /// Scenes that the curve is about, which are never learned from.
    pub probes: Vec<Scenery>,
    /// Clips of each.
    pub clips: u32,
    /// Random offset fields on each.
    pub responses: usize,
    /// Side of the frames in pixels.
    pub size_px: u32,
}

impl PretrainConfig {
    /// Number of scenes.
    #[must_use]
    pub fn num_scenes(&self) -> usize {
        count(&self.scenes)
    }
}

fn count(scenes: &[Scenery]) -> usize {
    let of = |scene: &Scenery| if let Scenery::Procedural(number) = scene { *number as usize } else { 1 };
    scenes.iter().map(of).sum()
}

/// What a scene added.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SceneReport {
    /// Its number, from 1.
    pub number: usize,
    /// `procedural:N` or the model's name.
    pub scene: String,
    /// Seconds that it took.
    pub seconds: f64,
    /// How well directions of all scenes so far tell marks from content in scenes that they are not from, as a share of
    /// what those scenes' own directions do.
    pub separation: f64,
}

/// A pretrained extractor in the making.
pub struct Pretraining<'a> {
    device: &'a Device,
    clip: &'a ClipModel,
    config: PretrainConfig,
    prf: Prf,
    features: FeatureExtractor,
    tmsd: TmsdWeights,
    /// What moves features in scenes that are not learned from, and how well their own directions separate it.
    probes: Vec<(Scatter, f64)>,
    scatter: Option<Scatter>,
    reports: Vec<SceneReport>,
}

impl<'a> Pretraining<'a> {
    /// Measures the scenes that it will be judged by.
    ///
    /// # Errors
    /// [`EngineError::Usage`] without a scene; when the device fails.
    pub fn prepare(device: &'a Device, clip: &'a ClipModel, config: PretrainConfig) -> Result<Self, EngineError> {
        let (few, scenes) = (config.bits.min(CURVE_BITS), config.num_scenes());
        let is_little = count(&config.probes) == 0 || config.clips == 0 || few == 0 || config.responses < few;
        if is_little || scenes * config.responses < config.bits {
            let PretrainConfig { clips, responses, bits, .. } = &config;
            return Err(EngineError::Usage {
                what: "pretraining".to_owned(),
                got: format!("{scenes} scenes, {clips} clips and {responses} fields on each, {bits} bits"),
                expected: format!(
                    "a probe, a clip, at least {few} fields on each scene, and as many on all as there are bits"
                ),
            });
        }
        // A stranger's key: its seed is public.
        let mut secret = [0; 32];
        secret[..8].copy_from_slice(&config.seed.to_le_bytes());
        let prf = Prf::new(&MasterSecret::from_bytes(secret));
        let mut rng = prf.stream(Purpose::TmsdInit, 0);
        let tmsd = TmsdWeights::new(TmsdConfig::colour_map_only(), SAME_COLOURS, &mut rng);
        let features = FeatureExtractor::new(device, clip, Some(&tmsd), 1, TowerPurpose::Features)?;
        let mut this =
            Self { device, clip, config, prf, features, tmsd, probes: Vec::new(), scatter: None, reports: Vec::new() };
        let probes = this.config.probes.clone();
        for number in 0..count(&probes) {
            // Procedural ones from the other end of the row than those that are learned from.
            let (_, model) = this.scene(&probes, number, &|index| u64::MAX - index)?;
            let scatter = this.measure(&model, u64::MAX - number as u64)?;
            let own = scatter.separation(&scatter.discriminants(this.curve_bits())?)?;
            this.probes.push((scatter, own));
        }
        Ok(this)
    }

    /// What the scenes added that are in it so far.
    #[must_use]
    pub fn reports(&self) -> &[SceneReport] {
        &self.reports
    }

    fn curve_bits(&self) -> usize {
        self.config.bits.min(CURVE_BITS)
    }

    /// Scene number `index` of a list and its name; `place` says where a procedural one stands in the row of all.
    fn scene(
        &self,
        list: &[Scenery],
        index: usize,
        place: &dyn Fn(u64) -> u64,
    ) -> Result<(String, Model), EngineError> {
        let mut left = index;
        for scene in list {
            match scene {
                Scenery::Procedural(number) if left < *number as usize => {
                    let mut rng = self.prf.stream(Purpose::Scenes, place(left as u64));
                    return Ok((format!("procedural:{left}"), procedural::scene(&mut rng)?));
                }
                Scenery::Procedural(number) => left -= *number as usize,
                Scenery::Path(path) if left == 0 => return Ok((scene.to_string(), Model::open(path)?)),
                Scenery::Path(_) => left -= 1,
            }
        }
        unreachable!("asked for no more scenes than there are")
    }

    /// What moves the features of a scene; `index` names its views and offsets.
    fn measure(&mut self, model: &Model, index: u64) -> Result<Scatter, EngineError> {
        let PretrainConfig { clips, responses, size_px, .. } = self.config;
        let usual = EmbedConfig::new(Profile::Balanced, ExtractorMode::Blind);
        let settings = usual.with_probes(responses).for_degree(model.gaussians.sh_degree).with(|settings| {
            settings.seed = index;
            (settings.views.clips, settings.views.size_px) = (clips, (size_px, size_px));
            // Directions are the same for all scenes; how films of one are framed is no part of them.
            settings.views.framing = FramingChoice::Whole;
            // What brightness does differs from scene to scene more than what marks do: with it 88 % of the bits of fox
            // and robot were read, without it 92 (two keys each, 150 steps).
            settings.extractor.calibration_mut().into_iter().for_each(|calibration| calibration.copies.clear());
            settings.optimiser.held_out_every = 0;
        });
        let mut buffers = TrainingBuffers::new(self.device, model, &settings, self.features.side())?;
        let mut pool = ClipPool::draw(self.device, model, &self.prf, &settings)?;
        pool.fill(&mut buffers)?;
        let (device, prf) = (self.device, &self.prf);
        let mut context = FitContext { device, config: &settings, prf, pool: &mut pool, buffers: &mut buffers };
        let map = fit::colour_map(&mut context)?;
        if let (Some(tmsd), Some(map)) = (self.features.tmsd(), map) {
            tmsd.set_colour_map(map);
        }
        let content = fit::content(&mut context, &mut self.features, None)?;
        let seen = Seen::of(&mut context, &mut self.features, content, None)?;
        Scatter::of(&seen.features())
    }

    /// Adds the next scene; `None` when all are in.
    ///
    /// # Errors
    /// Those of [`Model::open`]; when the device fails.
    pub fn step(&mut self) -> Result<Option<SceneReport>, EngineError> {
        let done = self.reports.len();
        if done >= self.config.num_scenes() {
            return Ok(None);
        }
        let started = Instant::now();
        let (scene, model) = self.scene(&self.config.scenes, done, &|index| index)?;
        let scatter = self.measure(&model, done as u64)?;
        let all = self.scatter.as_ref().map_or_else(|| scatter.stored(), |before| before.with(&scatter));
        let directions = all.discriminants(self.curve_bits())?;
        let mut separation = 0.0;
        for (probe, own) in &self.probes {
            separation += probe.separation(&directions)? / own / self.probes.len() as f64;
        }
        self.scatter = Some(all);
        let report = SceneReport { number: done + 1, scene, seconds: started.elapsed().as_secs_f64(), separation };
        self.reports.push(report.clone());
        Ok(Some(report))
    }

    /// What a checkpoint must agree with.
    fn identity(&self) -> String {
        let settings = serde_json::to_string(&self.config).expect("numbers and words are valid JSON");
        Digest::of([settings, digest_of(self.clip).to_string()].concat().as_bytes()).to_string()
    }

    /// Writes what is known so far.
    ///
    /// # Errors
    /// [`EngineError::Io`] naming the file.
    pub fn save(&self, path: &Path) -> Result<(), EngineError> {
        let mut file = TensorFile::default();
        file.meta.insert("format".to_owned(), FORMAT.to_owned());
        file.meta.insert("identity".to_owned(), self.identity());
        let reports = serde_json::to_string(&self.reports).expect("figures are valid JSON");
        file.meta.insert("reports".to_owned(), reports);
        if let Some(scatter) = &self.scatter {
            scatter.store(&mut file);
        }
        AtomicFile::write(path, Existing::Replace, &file.to_bytes()?)
    }

    /// Takes up what [`Pretraining::save`] wrote; going on from there gives the same bytes.
    ///
    /// # Errors
    /// [`EngineError::BadData`] when it belongs to other settings or is damaged.
    pub fn restore(&mut self, path: &Path) -> Result<(), EngineError> {
        let file = TensorFile::read(path)?;
        file.expect_text("format", FORMAT)?;
        file.expect_text("identity", &self.identity())?;
        let text = file.text("reports")?;
        let reports: Vec<SceneReport> =
            serde_json::from_str(text).map_err(|error| file.bad("reports", &error.to_string(), "scenes"))?;
        self.scatter = if reports.is_empty() { None } else { Some(Scatter::load(&file)?) };
        self.reports = reports;
        Ok(())
    }

    /// The extractor as it is now; `made_by` is the command that made it.
    ///
    /// # Errors
    /// [`EngineError::Usage`] before the first scene.
    pub fn extractor(&self, made_by: String) -> Result<PretrainedExtractor, EngineError> {
        let scatter = self.scatter.as_ref().ok_or_else(|| EngineError::Usage {
            what: "pretrained extractor".to_owned(),
            got: "no scene".to_owned(),
            expected: "at least one".to_owned(),
        })?;
        Ok(PretrainedExtractor {
            clip: digest_of(self.clip),
            tmsd: self.tmsd.clone(),
            directions: row_major(&scatter.discriminants(self.config.bits)?),
            most_bits: self.config.bits,
            least_content: scatter.least_content(),
            made_by,
        })
    }
}
