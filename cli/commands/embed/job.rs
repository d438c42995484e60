//! Settings of a run that change no mark: what is asked of the result, and where it is measured.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use clap::{ArgAction, Args};
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::camera::classes::CameraClass;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use crate::flags::size::parse_size;

/// Films of each class that are measured, at most: they are held in memory together.
const MOST_CLASS_FILMS: u32 = 100;

/// Settings of a run, beside those of the mark.
#[derive(Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct JobSettings {
    /// How it runs.
    #[command(flatten)]
    pub(crate) run: RunSettings,
    /// What is asked of the result.
    #[command(flatten)]
    pub(crate) gate: GateSettings,
    /// Where the result is measured.
    #[command(flatten)]
    pub(crate) evaluation: EvaluationSettings,
}

/// How much of the settings is taken, and what is written meanwhile.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Run")]
pub(crate) struct RunSettings {
    /// Whether to do no more than the scene needs: `full` or `auto`
    ///
    /// `full` takes all steps on everything: the strongest mark. `auto` begins with the splats that carry most of the
    /// light and half of the views; it takes all when clips that training never sees show no more progress. It stops
    /// when each of them proves the message alone, by a margin, or when they show no progress then either. The
    /// extractor stays what it is: `joint` gives no exact p-value, and is never chosen for you.
    #[arg(long, value_name = "WHEN", hide = true)]
    pub(crate) fit: Fit,
    /// Write a marked SPZ as SPZ, whose colours are rounded, instead of as PLY; what is judged is the mark that is left
    #[arg(long, action = ArgAction::Set, num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    #[arg(value_name = "BOOL", hide = true)]
    pub(crate) lossy: bool,
    /// Train near the cameras of this file or folder instead of all around, and measure around what they look at
    ///
    /// The kinds are those of --cameras. Their frames have to have the shape of --size. The receipt keeps the cameras.
    #[arg(long, value_name = "PATH", hide = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) train_cameras: Option<PathBuf>,
    /// Write a checkpoint this often, in seconds
    #[arg(long = "checkpoint-every", value_name = "SECONDS", hide = true)]
    pub(crate) checkpoint_every_s: u64,
}

impl Default for RunSettings {
    fn default() -> Self {
        Self { fit: Fit::Full, lossy: false, train_cameras: None, checkpoint_every_s: 60 }
    }
}

/// How much is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Fit {
    /// No more than the scene needs.
    Auto,
    /// All steps.
    Full,
}

impl FromStr for Fit {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        match text {
            "auto" => Ok(Self::Auto),
            "full" => Ok(Self::Full),
            _ => Err(EngineError::Usage {
                what: "fit".to_owned(),
                got: text.to_owned(),
                expected: "auto or full".to_owned(),
            }),
        }
    }
}

impl fmt::Display for Fit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// Least quality of the result; what falls short is told, and the exit code is 1.
#[derive(Args, Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Run")]
pub(crate) struct GateSettings {
    /// Least share of bits right on unseen clips, 0 to 1; by default half of these clips must each prove the message
    /// alone instead
    ///
    /// above:0.9 asks for a share in films from above; so with every class of cameras: usual, above, below, far, near,
    /// wide, narrow, portrait, off-centre and roll. In a file this is a share, or a list of such texts.
    #[arg(long, value_name = "[CLASS:]SHARE", value_delimiter = ',', hide = true)]
    #[serde(default, skip_serializing_if = "Vec::is_empty", deserialize_with = "one_or_more")]
    pub(crate) min_accuracy: Vec<LeastAccuracy>,
    /// Least PSNR of whole unseen frames in dB; by default none
    #[arg(long, value_name = "DB", hide = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) min_psnr: Option<f64>,
}

/// A share of bits that is asked for, of all clips or of films of one class of cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LeastAccuracy {
    /// None for clips of the cameras that the result is measured with.
    pub(crate) class: Option<CameraClass>,
    /// 0 to 1
    pub(crate) share: f64,
}

impl FromStr for LeastAccuracy {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        let (class, share) = match text.split_once(':') {
            Some((class, share)) => (Some(class.parse()?), share),
            None => (None, text),
        };
        let share = share.trim().parse().map_err(|_| EngineError::Usage {
            what: "least share of bits right".to_owned(),
            got: text.to_owned(),
            expected: "a number from 0 to 1, or a class and a number: above:0.9".to_owned(),
        })?;
        Ok(Self { class, share })
    }
}

impl fmt::Display for LeastAccuracy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.class {
            Some(class) => write!(f, "{class}:{}", self.share),
            None => write!(f, "{}", self.share),
        }
    }
}

impl Serialize for LeastAccuracy {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for LeastAccuracy {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match NumberOrText::deserialize(deserializer)? {
            NumberOrText::Number(share) => Ok(Self { class: None, share }),
            NumberOrText::Text(text) => text.parse().map_err(de::Error::custom),
        }
    }
}

#[derive(Deserialize)]
#[serde(untagged)]
enum NumberOrText {
    Number(f64),
    Text(String),
}

/// A value by itself, or a list.
fn one_or_more<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<LeastAccuracy>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Given {
        One(LeastAccuracy),
        More(Vec<LeastAccuracy>),
    }
    Ok(match Given::deserialize(deserializer)? {
        Given::One(one) => vec![one],
        Given::More(more) => more,
    })
}

/// Views that the result is measured in. Training has its own.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Quality")]
pub(crate) struct EvaluationSettings {
    /// Measure the result in the views of this camera file or folder; its content tells which kind
    ///
    /// Known are transforms JSON (D-NeRF, Blender, nerfstudio), cameras.json (INRIA), camera_path.json (nerfstudio), a
    /// COLMAP folder (text or binary; itself or with sparse/0) or a Nerfies/HyperNeRF folder.
    #[arg(long, value_name = "PATH", conflicts_with = "orbit")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) cameras: Option<PathBuf>,
    /// Measure the result in this many views on a circle instead [default: 6]
    #[arg(long, value_name = "VIEWS")]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) orbit: Option<u32>,
    /// Elevation of the circle in degrees above the horizon
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true, hide = true)]
    pub(crate) elevation: f32,
    /// Frames per view of the circle, and of cameras without times, spread over the whole motion
    #[arg(long, value_name = "N", hide = true)]
    pub(crate) frames: u32,
    /// Film this many frames on a smooth flight through --cameras, while time runs from 0 to 1
    #[arg(long, value_name = "FRAMES", hide = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) interpolate: Option<u32>,
    /// Let the flight come back to its first camera
    #[arg(long, action = ArgAction::Set, num_args = 0..=1, require_equals = true, default_missing_value = "true")]
    #[arg(value_name = "BOOL", hide = true)]
    pub(crate) closed: bool,
    /// Scale what --cameras shows to this size; --size on the command line does so, too. A circle is filmed in the size
    /// of the training views
    #[arg(long = "evaluation-size", value_name = "WIDTHxHEIGHT", value_parser = parse_size, hide = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) frame_px: Option<(u32, u32)>,
    /// Films of each class of cameras that the result is measured in besides, each of 8 frames once around the scene; 0
    /// for none
    #[arg(long, value_name = "N", hide = true)]
    pub(crate) class_films: u32,
}

impl Default for EvaluationSettings {
    fn default() -> Self {
        Self {
            cameras: None,
            orbit: None,
            elevation: 30.0,
            frames: 8,
            interpolate: None,
            closed: false,
            frame_px: None,
            class_films: 2,
        }
    }
}

impl EvaluationSettings {
    /// Refuses what needs what is not there, and more films than anybody waits for.
    pub(crate) fn validate(&self) -> Result<(), EngineError> {
        let lacks = |what: &str, needs: &str| {
            let (got, expected) = (format!("no {needs}"), format!("{needs} beside it"));
            Err(EngineError::Usage { what: what.to_owned(), got, expected })
        };
        match self {
            Self { interpolate: Some(_), cameras: None, .. } => lacks("interpolate", "cameras"),
            Self { closed: true, interpolate: None, .. } => lacks("closed", "interpolate"),
            Self { class_films: films, .. } if *films > MOST_CLASS_FILMS => Err(EngineError::Usage {
                what: "class-films".to_owned(),
                got: films.to_string(),
                expected: format!("at most {MOST_CLASS_FILMS}"),
            }),
            _ => Ok(()),
        }
    }
}
