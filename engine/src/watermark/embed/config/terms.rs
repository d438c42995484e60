//! The terms of the loss that are chosen by name: control losses, their clips, and LPIPS.

use std::fmt;
use std::str::FromStr;

use clap::Args;
use guard4d_kernels::image::resize::ImageSize;
use guard4d_kernels::loss::bce::Objective;
use serde::{Deserialize, Serialize};

use super::parse::{check, word};
use super::weights_file::WeightsFile;
use crate::error::EngineError;
use crate::networks::lpips::{LpipsInput, LpipsWeights};

/// The control loss of `joint` (Guard4D Eq. 10 and its bounded relatives).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum Control {
    /// 1 / (BCE + ε), the paper's.
    InverseBce {
        /// ε
        eps: f32,
    },
    /// The same, but it stops at chance.
    Hinge {
        /// ε
        eps: f32,
    },
    /// Mean squared logit.
    Chance,
}

/// `inverse-bce:EPS`, `hinge:EPS` or `chance`.
impl FromStr for Control {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        let bad = || EngineError::Usage {
            what: "control loss".to_owned(),
            got: text.to_owned(),
            expected: "inverse-bce:EPS, hinge:EPS with a positive EPS, or chance".to_owned(),
        };
        let (name, eps) = text.split_once(':').unwrap_or((text, ""));
        let positive = || eps.parse::<f32>().ok().filter(|eps| eps.is_finite() && *eps > 0.0).ok_or_else(bad);
        match (name, eps) {
            ("inverse-bce", _) => Ok(Self::InverseBce { eps: positive()? }),
            ("hinge", _) => Ok(Self::Hinge { eps: positive()? }),
            ("chance", "") => Ok(Self::Chance),
            _ => Err(bad()),
        }
    }
}

impl fmt::Display for Control {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::InverseBce { eps } => write!(f, "inverse-bce:{eps}"),
            Self::Hinge { eps } => write!(f, "hinge:{eps}"),
            Self::Chance => f.write_str("chance"),
        }
    }
}

impl From<Control> for String {
    fn from(control: Control) -> Self {
        control.to_string()
    }
}

impl TryFrom<String> for Control {
    type Error = EngineError;

    fn try_from(text: String) -> Result<Self, EngineError> {
        text.parse()
    }
}

impl Control {
    pub(in super::super) fn objective(self) -> Objective {
        match self {
            Self::InverseBce { eps } => Objective::InverseBce { eps },
            Self::Hinge { eps } => Objective::Hinge { eps },
            Self::Chance => Objective::Chance,
        }
    }
}

/// Which unmarked clips hold `joint` back (the paper's Table 4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ControlClips {
    /// Clean and noisy ones by turns.
    #[default]
    Both,
    /// Clean ones alone.
    Clean,
    /// Noisy ones alone.
    Noisy,
}

impl FromStr for ControlClips {
    type Err = EngineError;

    fn from_str(text: &str) -> Result<Self, EngineError> {
        word("control clips", text)
    }
}

/// LPIPS as part of the fidelity loss, or with a weight of 0 as a figure of the result alone.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "LPIPS")]
pub struct LpipsTerm {
    /// LPIPS weights, version 0.1 for AlexNet or VGG16, as safetensors: report LPIPS, and train with it if
    /// --lambda-lpips says so
    #[arg(long = "lpips", value_name = "FILE", hide = true)]
    pub network: WeightsFile<LpipsWeights>,
    /// Range in which LPIPS is given colours: `canonical`, -1 to 1, as it is defined; or `unit`, 0 to 1, as much of the
    /// literature on splats feeds it, whose figures are others
    #[arg(long = "lpips-input", value_name = "RANGE", hide = true)]
    #[serde(default)]
    pub input: LpipsInput,
    /// Weight of LPIPS in the loss (GuardSplat: 1, AlexNet, fed with 0 to 1); 0 only reports it
    #[arg(long = "lambda-lpips", value_name = "WEIGHT", hide = true)]
    #[serde(default)]
    pub lambda: f32,
    /// Train LPIPS on a square part of the frames of this side, another in every step, instead of whole frames: faster
    #[arg(long = "lpips-crop", value_name = "PX", hide = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop_px: Option<u32>,
    /// Train LPIPS in every K-th step only, and count it K times: faster, less exact
    #[arg(long = "lpips-every", value_name = "K", hide = true)]
    #[serde(default = "every_step")]
    pub every: u32,
}

fn every_step() -> u32 {
    1
}

/// Reported, and no part of the loss.
impl Default for LpipsTerm {
    fn default() -> Self {
        Self { network: WeightsFile::default(), input: LpipsInput::default(), lambda: 0.0, crop_px: None, every: 1 }
    }
}

impl LpipsTerm {
    /// As GuardSplat takes it.
    #[must_use]
    pub fn of_the_paper(network: WeightsFile<LpipsWeights>) -> Self {
        Self { network, input: LpipsInput::UnitFed, lambda: 1.0, crop_px: None, every: 1 }
    }

    /// Size of what is compared in a step.
    pub(in super::super) fn part_of(&self, frame: ImageSize) -> ImageSize {
        let side = self.crop_px.map_or(usize::MAX, |px| px as usize);
        ImageSize { height: frame.height.min(side), width: frame.width.min(side) }
    }

    pub(super) fn validate(&self) -> Result<(), EngineError> {
        check("lambda_lpips", self.lambda, self.lambda.is_finite() && self.lambda >= 0.0, "0 or more")?;
        check("lpips_every", self.every, self.every > 0, "at least 1")
    }

    /// Refuses frames that are too small for the network.
    pub(super) fn validate_network(&self, frame: ImageSize) -> Result<(), EngineError> {
        let (net, part) = (self.network.get()?.net(), self.part_of(frame));
        let (side, least) = (part.height.min(part.width), net.min_side_px());
        check("side of what LPIPS compares", side, side >= least, &format!("at least {least} px for {net}"))
    }
}
