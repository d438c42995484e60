//! What a study measures: arms, scenes and seeds, and what is read of each.

use std::fmt;

use guard4d_engine::base::digest::Digest;
use guard4d_engine::evidence::extractor_mode::ExtractorMode;
use guard4d_engine::networks::lpips::LpipsWeights;
use guard4d_engine::picture::distortion::Distortion;
use guard4d_engine::watermark::embed::{EmbedConfig, Extractor, LpipsTerm, Profile, WeightsFile};
use guard4d_engine::watermark::extractor::pretrained::PretrainedExtractor;
use guard4d_kernels::nn::pack::Precision;

use super::scene::{SceneSource, Variant};

/// Hexadecimal digits that name an embedding.
const ID_DIGITS: usize = 16;

/// Side in pixels of films that are distorted, whatever training's is. Codecs work on blocks of 8 and 16 px: a film of
/// 100 px, which CLIP reads nearly as it is, loses marks to them that one of the usual size keeps.
pub(super) const COPY_PX: u32 = 400;

/// How a film is made that the message is read from. The first is what training aims at; the others are farther off.
#[derive(Clone, Debug, PartialEq)]
pub enum Take {
    /// The scene's unseen cameras.
    Plain,
    /// The same at `COPY_PX`, distorted.
    Distorted(Distortion),
    /// The same at `COPY_PX` through H.264 at this constant rate factor.
    H264(u8),
    /// The mark made so many times as strong.
    Strength(f32),
    /// So many frames of every clip.
    Frames(usize),
    /// Cameras at this elevation, degrees; training ends at 65.
    Elevation(f64),
    /// Cameras at this multiple of the training distance.
    Distance(f64),
    /// Times of the motion's first or last part only.
    Times(f32, f32),
    /// Width and height in pixels.
    Size(u32, u32),
}

impl fmt::Display for Take {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Plain => f.write_str("plain"),
            Self::Distorted(distortion) => write!(f, "{distortion}, {COPY_PX} px"),
            Self::H264(crf) => write!(f, "h264 crf {crf}, {COPY_PX} px"),
            Self::Strength(factor) => write!(f, "strength {factor}"),
            Self::Frames(count) => write!(f, "{count} frames"),
            Self::Elevation(degrees) => write!(f, "elevation {degrees}"),
            Self::Distance(factor) => write!(f, "distance x{factor}"),
            Self::Times(first, last) => write!(f, "times {first} to {last}"),
            Self::Size(width, height) => write!(f, "{width}x{height} px"),
        }
    }
}

/// One way to embed, and what is read of it.
#[derive(Clone, Debug)]
pub struct Arm {
    /// Its name in tables; arms of one name are one line.
    pub name: String,
    /// Settings; the seed comes from the study.
    pub config: EmbedConfig,
    /// Message bits.
    pub bits: u32,
    /// How CLIP's matrices are kept.
    pub precision: Precision,
    /// What is done to the scene first.
    pub variant: Variant,
    /// What is read.
    pub takes: Vec<Take>,
    /// Whether the device's memory holds half of the training clips only, so that the others are made again.
    pub is_tight: bool,
    /// Whether other copies are made: with another message through the frozen extractor, and by another owner; and
    /// whether an accuser tries to forge one.
    pub is_contested: bool,
}

impl Arm {
    /// Plain settings, read plainly.
    pub(super) fn new(name: impl Into<String>, config: EmbedConfig) -> Self {
        Self {
            name: name.into(),
            config,
            bits: DEFAULT_BITS,
            precision: Precision::F32,
            variant: Variant::AsIs,
            takes: vec![Take::Plain],
            is_tight: false,
            is_contested: false,
        }
    }
}

/// Message bits of most arms, the paper's.
pub(super) const DEFAULT_BITS: u32 = 16;

/// Where a study runs.
#[derive(Clone, Debug)]
pub struct Machine {
    /// Device and driver.
    pub device: String,
    /// Hash of the CLIP checkpoint.
    pub clip: String,
}

/// An arm on a scene with a seed, which its settings hold.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Scene.
    pub scene: SceneSource,
    /// Arm.
    pub arm: Arm,
}

impl Cell {
    /// Names the embedding by all that decides it; arms of several sub-studies that are the same embedding share it.
    pub(super) fn id(&self, machine: &Machine) -> String {
        let Arm { config, bits, precision, variant, is_tight, .. } = &self.arm;
        let settings = config.identity();
        let all = format!(
            "{} {} {} {variant} {bits} {} {is_tight} {settings}",
            machine.clip,
            machine.device,
            self.scene,
            precision.name()
        );
        Digest::of(all.as_bytes()).to_string().chars().take(ID_DIGITS).collect()
    }
}

/// How much is spent on each embedding, and on how many of them.
#[derive(Clone, Debug)]
pub struct Scale {
    /// Scenes.
    pub scenes: Vec<SceneSource>,
    /// Seeds.
    pub seeds: Vec<u8>,
    /// Side of frames in pixels.
    pub size_px: u32,
    /// Training steps, instead of the profiles'.
    pub steps: Option<usize>,
    /// Training clips, instead of the profiles'.
    pub clips: Option<u32>,
    /// Random fields that calibrations are fitted to, instead of the profiles'.
    pub probes: Option<usize>,
    /// Rotations tried by extractors that can choose one.
    pub rotations: Option<u32>,
    /// What arms of `pretrained` read through; without it there are none.
    pub pretrained: Option<WeightsFile<PretrainedExtractor>>,
    /// LPIPS for the paper's objective and for all readings.
    pub lpips: Option<WeightsFile<LpipsWeights>>,
    /// Whether only the arms are taken that a first look needs.
    pub quick: bool,
    /// Take only arms whose name holds one of these words; empty takes all.
    pub only: Vec<String>,
}

impl Scale {
    /// Ends within a quarter of an hour on two processor cores with the built-in CLIP, whatever the sub-study; figures
    /// are those of marks that are far from finished.
    #[must_use]
    pub fn quick() -> Self {
        Self {
            scenes: vec![SceneSource::Demo],
            seeds: vec![0],
            size_px: 100,
            steps: Some(60),
            clips: Some(16),
            probes: Some(32),
            rotations: None,
            pretrained: None,
            lpips: None,
            quick: true,
            only: Vec::new(),
        }
    }

    /// The profiles' own effort, for a GPU.
    #[must_use]
    pub fn full() -> Self {
        Self {
            scenes: vec![SceneSource::Demo],
            seeds: vec![0, 1, 2],
            size_px: 400,
            steps: None,
            clips: None,
            probes: None,
            rotations: None,
            pretrained: None,
            lpips: None,
            quick: false,
            only: Vec::new(),
        }
    }

    /// A profile's settings at this scale.
    pub(super) fn config(&self, profile: Profile, mode: ExtractorMode) -> EmbedConfig {
        let lpips = self.lpips.as_ref().filter(|_| profile.is_the_papers());
        let config = EmbedConfig::new(profile, mode).with(|config| {
            config.optimiser.steps = self.steps.unwrap_or(config.optimiser.steps);
            config.views.clips = self.clips.unwrap_or(config.views.clips);
            config.views.size_px = (self.size_px, self.size_px);
            config.objective.lpips = lpips.cloned().map(LpipsTerm::of_the_paper);
            // Nobody watches.
            config.optimiser.held_out_every = 0;
            if let (Extractor::Pretrained(own), Some(given)) = (&mut config.extractor, &self.pretrained) {
                own.weights = given.clone();
            }
        });
        let probes = self.probes.unwrap_or(config.extractor.probes());
        let rotations = self.rotations.unwrap_or(config.extractor.rotations());
        config.with_probes(probes).with_rotations(rotations)
    }

    /// What the program does unless told otherwise, at this scale.
    pub(super) fn default_config(&self) -> EmbedConfig {
        self.config(Profile::Balanced, Profile::Balanced.default_mode())
    }

    /// Every arm on every scene with every seed; seeds outermost, so that a run that is broken off has all arms.
    pub(super) fn cells(&self, arms: &[Arm]) -> Vec<Cell> {
        let is_possible = |arm: &Arm| arm.config.mode() != ExtractorMode::Pretrained || self.pretrained.is_some();
        let is_asked = |arm: &Arm| self.only.is_empty() || self.only.iter().any(|words| arm.name.contains(words));
        let is_wanted = |arm: &&Arm| is_possible(arm) && is_asked(arm);
        let of = |seed: u8, scene: &SceneSource, arm: &Arm| {
            let config = arm.config.clone().with(|c| c.seed = u64::from(seed));
            Cell { scene: scene.clone(), arm: Arm { config, ..arm.clone() } }
        };
        let scenes = |seed: u8| {
            self.scenes.iter().flat_map(move |s| arms.iter().filter(is_wanted).map(move |arm| of(seed, s, arm)))
        };
        self.seeds.iter().flat_map(|&seed| scenes(seed)).collect()
    }
}
