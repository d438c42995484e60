//! What frames pass through before CLIP, and so what a match proves.

use clap::Args;
use serde::{Deserialize, Serialize};

use super::parse::{check, check_weight, word};
use super::profile::Profile;
use super::terms::{Control, ControlClips};
use super::weights_file::WeightsFile;
use crate::error::EngineError;
use crate::evidence::extractor_mode::ExtractorMode;
use crate::picture::distortion::Distortion;
use crate::watermark::extractor::pretrained::PretrainedExtractor;
use crate::watermark::extractor::rotation::MAX_ROTATIONS;
use crate::watermark::extractor::tmsd::TmsdConfig;

/// Random offset fields of a calibration.
const DEFAULT_PROBES: usize = 64;
/// Copies whose content the calibration of `blind` silences. Where a brighter picture is clamped its colours turn where
/// the asset has none, which R amplifies: an unmarked copy 1.3 times as bright said ten times as much as a mark.
/// Compression, turns and crops move what content says by less than a mark, and cost more as content than they gain
/// (docs/log/2026-11-23.md, "Copies").
const DEFAULT_COPIES: [&str; 1] = ["brightness:0.7..1.3"];
/// Share of the steps before R of `joint` is trained. On 48 bits (robot, one key, 400 steps) training it from the start
/// read 79.9 % at 50.4 dB, R learning to read a mark that is hardly there; this share reads 88.1 % at 45.1 dB in less
/// time.
const DEFAULT_TMSD_HELD: f32 = 0.5;

/// How R is made, with what that takes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "mode", rename_all = "snake_case")]
pub enum Extractor {
    /// CLIP and the decoder alone.
    None(NoneConfig),
    /// A front end that never saw the message.
    Blind(BlindConfig),
    /// The same, with directions learned once from other scenes, before anyone had this one.
    Pretrained(PretrainedConfig),
    /// The paper's front end, trained with the message.
    Joint(JointConfig),
}

/// What of a frame's features is taken off as the unmarked frame's own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ContentChoice {
    /// The mean of all unmarked frames; the default of settings from before there was a choice.
    #[default]
    Mean,
    /// What each frame is foretold to say unmarked, see [`crate::watermark::extractor::content`].
    Foretold,
}

fn content(text: &str) -> Result<ContentChoice, EngineError> {
    word("content", text)
}

/// How an extractor's directions are fitted to the unmarked asset.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Extractor")]
pub struct CalibrationConfig {
    /// Random offset fields that the calibration is fitted to, at least one per bit
    #[arg(long, value_name = "N", hide = true)]
    pub probes: usize,
    /// Standard deviation of these fields, in colour
    #[arg(long, value_name = "COLOUR", hide = true)]
    pub probe_level: f64,
    /// Copies of unmarked clips that count as content too, at both ends of each range of strengths
    #[arg(long = "calibration-copies", value_name = "NAME:STRENGTH", value_delimiter = ',', hide = true)]
    #[arg(allow_hyphen_values = true)]
    pub copies: Vec<Distortion>,
}

/// The colour map in front of R.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Extractor")]
pub struct ColourConfig {
    /// Gain of R along the colour direction that the unmarked asset uses least
    #[arg(long, value_name = "GAIN", hide = true)]
    pub null_gain: f64,
    /// Colour level below which a direction counts as unused
    #[arg(long, value_name = "COLOUR", hide = true)]
    pub null_level: f64,
}

/// Settings of `none`.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NoneConfig {
    /// How its directions are fitted.
    #[command(flatten)]
    pub calibration: CalibrationConfig,
}

/// Settings of `blind`.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Extractor")]
pub struct BlindConfig {
    /// What of a frame's features is taken off as the unmarked frame's own: `mean`, the same of all frames, or
    /// `foretold`, what each is foretold to say by what it shows
    #[arg(long, value_name = "WHAT", value_parser = content, hide = true)]
    #[serde(default)]
    pub content: ContentChoice,
    /// Rotations of the key that are tried before the best for the message is taken; every p-value is multiplied by
    /// them. Only extractors that know nothing else of the message have a choice
    #[arg(long, value_name = "K", hide = true)]
    pub rotations: u32,
    /// How its directions are fitted.
    #[command(flatten)]
    pub calibration: CalibrationConfig,
    /// Its colour map.
    #[command(flatten)]
    pub colours: ColourConfig,
}

/// Settings of `pretrained`.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Extractor")]
pub struct PretrainedConfig {
    /// Pretrained extractor, as `lab pretrain` writes it; one for `mini` is built in
    #[arg(long = "pretrained", value_name = "FILE", hide = true)]
    #[serde(default)]
    pub weights: WeightsFile<PretrainedExtractor>,
    /// What of a frame's features is taken off as the unmarked frame's own: `mean`, the same of all frames, or
    /// `foretold`, what each is foretold to say by what it shows
    #[arg(long, value_name = "WHAT", value_parser = content, hide = true)]
    #[serde(default)]
    pub content: ContentChoice,
    /// Rotations of the key that are tried before the best for the message is taken; every p-value is multiplied by
    /// them. Only extractors that know nothing else of the message have a choice
    #[arg(long, value_name = "K", hide = true)]
    pub rotations: u32,
    /// Its colour map.
    #[command(flatten)]
    pub colours: ColourConfig,
}

/// Settings of `joint`.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Extractor")]
pub struct JointConfig {
    /// Share of the steps in which R stays as it was fitted, at the start: the mark then goes where an R goes that
    /// never saw the message, and training R adds to that
    #[arg(long, value_name = "SHARE", hide = true)]
    pub tmsd_held: f32,
    /// Adam's rate for R
    #[arg(long, value_name = "RATE", hide = true)]
    pub lr_tmsd: f32,
    /// Control loss: inverse-bce:EPS (paper), hinge:EPS or chance
    #[arg(long, value_name = "LOSS", hide = true)]
    pub control: Control,
    /// Unmarked clips that hold R back: `both` clean and noisy ones by turns, or `clean` or `noisy` ones alone
    #[arg(long, value_name = "CLIPS", hide = true)]
    pub control_clips: ControlClips,
    /// Weight of each control branch against the message loss
    #[arg(long, value_name = "WEIGHT", hide = true)]
    pub lambda_control: f32,
    /// Read a control on every K-th step only, and count it K times: faster, less exact
    ///
    /// Between them a step reads only the marked clip, against the logits of the last control, which is cheaper by that
    /// control's way through R and CLIP. Whatever goes back through a control counts K times, so that over K steps R's
    /// mean gradient stays what a control in every step would give: with the marked clips' share alone, R would learn
    /// to say the message whatever it sees.
    #[arg(long, value_name = "K", hide = true)]
    pub control_every: u32,
    /// Size of R.
    #[command(flatten)]
    pub tmsd: TmsdConfig,
    /// How its directions are fitted.
    #[command(flatten)]
    pub calibration: CalibrationConfig,
    /// Its colour map.
    #[command(flatten)]
    pub colours: ColourConfig,
}

impl Extractor {
    /// The settings of a profile, before they are sized for a fidelity.
    pub(super) fn new(profile: Profile, mode: ExtractorMode) -> Self {
        let copies = |copies: &[&str]| copies.iter().map(|text| text.parse().expect("a distortion")).collect();
        let calibration = |names| CalibrationConfig { probes: DEFAULT_PROBES, probe_level: 0.0, copies: copies(names) };
        let colours = ColourConfig { null_gain: 0.0, null_level: 0.0 };
        let is_the_papers = profile.is_the_papers();
        let content = if is_the_papers { ContentChoice::Mean } else { ContentChoice::Foretold };
        match mode {
            ExtractorMode::None => Self::None(NoneConfig { calibration: calibration(&[]) }),
            ExtractorMode::Blind => Self::Blind(BlindConfig {
                content,
                rotations: 1,
                calibration: calibration(if is_the_papers { &[] } else { &DEFAULT_COPIES }),
                colours,
            }),
            ExtractorMode::Pretrained => {
                let weights = WeightsFile::default();
                Self::Pretrained(PretrainedConfig { weights, content, rotations: 1, colours })
            }
            ExtractorMode::Joint => Self::Joint(JointConfig {
                tmsd_held: if is_the_papers { 0.0 } else { DEFAULT_TMSD_HELD },
                lr_tmsd: 1e-3,
                control: Control::InverseBce { eps: 0.5 },
                control_clips: ControlClips::Both,
                // One control a step stands for both of the paper's, so that it counts twice.
                lambda_control: if is_the_papers { 2.0 } else { 0.05 },
                control_every: 1,
                tmsd: TmsdConfig::default(),
                calibration: calibration(&[]),
                colours,
            }),
        }
    }

    /// Which it is.
    #[must_use]
    pub fn mode(&self) -> ExtractorMode {
        match self {
            Self::None(_) => ExtractorMode::None,
            Self::Blind(_) => ExtractorMode::Blind,
            Self::Pretrained(_) => ExtractorMode::Pretrained,
            Self::Joint(_) => ExtractorMode::Joint,
        }
    }

    /// How its directions are fitted; those of `pretrained` are not.
    #[must_use]
    pub fn calibration(&self) -> Option<&CalibrationConfig> {
        match self {
            Self::None(NoneConfig { calibration })
            | Self::Blind(BlindConfig { calibration, .. })
            | Self::Joint(JointConfig { calibration, .. }) => Some(calibration),
            Self::Pretrained(_) => None,
        }
    }

    /// The same, to be changed.
    pub fn calibration_mut(&mut self) -> Option<&mut CalibrationConfig> {
        match self {
            Self::None(NoneConfig { calibration })
            | Self::Blind(BlindConfig { calibration, .. })
            | Self::Joint(JointConfig { calibration, .. }) => Some(calibration),
            Self::Pretrained(_) => None,
        }
    }

    /// What of a frame's features is taken off. R of `joint` changes them in training, and what `none` reads is
    /// CLIP's alone.
    #[must_use]
    pub fn content(&self) -> ContentChoice {
        match self {
            Self::Blind(BlindConfig { content, .. }) | Self::Pretrained(PretrainedConfig { content, .. }) => *content,
            Self::None(_) | Self::Joint(_) => ContentChoice::Mean,
        }
    }

    /// The same, to be changed, where there is a choice.
    pub fn content_mut(&mut self) -> Option<&mut ContentChoice> {
        match self {
            Self::Blind(BlindConfig { content, .. }) | Self::Pretrained(PretrainedConfig { content, .. }) => {
                Some(content)
            }
            Self::None(_) | Self::Joint(_) => None,
        }
    }

    /// The colour map in front of R, where there is an R.
    #[must_use]
    pub fn colours(&self) -> Option<&ColourConfig> {
        match self {
            Self::None(_) => None,
            Self::Blind(BlindConfig { colours, .. })
            | Self::Pretrained(PretrainedConfig { colours, .. })
            | Self::Joint(JointConfig { colours, .. }) => Some(colours),
        }
    }

    /// The same, to be changed.
    pub fn colours_mut(&mut self) -> Option<&mut ColourConfig> {
        match self {
            Self::None(_) => None,
            Self::Blind(BlindConfig { colours, .. })
            | Self::Pretrained(PretrainedConfig { colours, .. })
            | Self::Joint(JointConfig { colours, .. }) => Some(colours),
        }
    }

    /// Settings of `joint`, if it is that.
    #[must_use]
    pub fn joint(&self) -> Option<&JointConfig> {
        if let Self::Joint(joint) = self { Some(joint) } else { None }
    }

    /// The same, to be changed.
    pub fn joint_mut(&mut self) -> Option<&mut JointConfig> {
        if let Self::Joint(joint) = self { Some(joint) } else { None }
    }

    /// Rotations that are tried before one is taken for the message.
    #[must_use]
    pub fn rotations(&self) -> u32 {
        match self {
            Self::Blind(BlindConfig { rotations, .. }) | Self::Pretrained(PretrainedConfig { rotations, .. }) => {
                *rotations
            }
            Self::None(_) | Self::Joint(_) => 1,
        }
    }

    /// The same, to be changed, where there is a choice.
    pub fn rotations_mut(&mut self) -> Option<&mut u32> {
        match self {
            Self::Blind(BlindConfig { rotations, .. }) | Self::Pretrained(PretrainedConfig { rotations, .. }) => {
                Some(rotations)
            }
            Self::None(_) | Self::Joint(_) => None,
        }
    }

    /// Random fields that its calibration takes.
    #[must_use]
    pub fn probes(&self) -> usize {
        self.calibration().map_or(0, |calibration| calibration.probes)
    }

    pub(super) fn validate(&self) -> Result<(), EngineError> {
        let rotations = self.rotations();
        let expected = format!("1 to {MAX_ROTATIONS}");
        check("rotations", rotations, (1..=MAX_ROTATIONS).contains(&rotations), &expected)?;
        self.joint().map_or(Ok(()), JointConfig::validate)
    }

    /// Refuses a calibration that has too little for a message of `bits` bits.
    pub(super) fn validate_for(&self, bits: usize) -> Result<(), EngineError> {
        let Some(CalibrationConfig { probes, .. }) = self.calibration() else { return Ok(()) };
        check("probes", probes, *probes >= bits, &format!("at least one per bit, {bits}"))
    }
}

impl JointConfig {
    fn validate(&self) -> Result<(), EngineError> {
        self.tmsd.validate()?;
        check("TMSD depth", self.tmsd.depth, self.tmsd.depth > 0, "at least 2 for `joint`, which trains it")?;
        check("control_every", self.control_every, self.control_every > 0, "at least 1")?;
        check("tmsd_held", self.tmsd_held, (0.0..1.0).contains(&self.tmsd_held), "a share from 0 to less than 1")?;
        check_weight("lambda_control", self.lambda_control)
    }
}
