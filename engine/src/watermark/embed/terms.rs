//! The terms of the loss that are chosen by name: control losses, their clips, and LPIPS.

use std::str::FromStr;
use std::sync::Arc;

use guard4d_kernels::image::resize::ImageSize;
use guard4d_kernels::loss::bce::Objective;
use serde::{Serialize, Serializer};

use crate::error::EngineError;
use crate::lpips::{LpipsInput, LpipsWeights};

/// The control loss of `joint` (Guard4D Eq. 10 and its bounded relatives).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
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

impl Control {
    pub(super) fn objective(self) -> Objective {
        match self {
            Self::InverseBce { eps } => Objective::InverseBce { eps },
            Self::Hinge { eps } => Objective::Hinge { eps },
            Self::Chance => Objective::Chance,
        }
    }
}

/// Which unmarked clips hold `joint` back (the paper's Table 4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
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

impl ControlClips {
    #[allow(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
    pub(super) fn is_both(&self) -> bool {
        *self == Self::Both
    }
}

/// LPIPS as part of the fidelity loss, or with a weight of 0 as a figure of the result alone.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LpipsTerm {
    /// The network; files name it and its hash.
    #[serde(serialize_with = "name_of_weights")]
    pub weights: Arc<LpipsWeights>,
    /// Range in which it is given colours.
    pub input: LpipsInput,
    /// Weight in the loss (GuardSplat: 1, `AlexNet`, \[0, 1\]-fed), not a share of `EmbedConfig::lambda_recon`.
    pub lambda: f32,
    /// Side of a square part of the frames, another in every step, that is compared instead of whole frames.
    pub crop_px: Option<u32>,
    /// Steps from one comparison to the next, at least 1; its gradient counts this many times.
    pub every: u32,
}

impl LpipsTerm {
    /// As the paper's objective has it, after `GuardSplat`.
    #[must_use]
    pub fn of_the_paper(weights: Arc<LpipsWeights>) -> Self {
        Self { weights, input: LpipsInput::UnitFed, lambda: 1.0, crop_px: None, every: 1 }
    }

    /// Size of what is compared in a step.
    pub(super) fn part_of(&self, frame: ImageSize) -> ImageSize {
        let side = self.crop_px.map_or(usize::MAX, |px| px as usize);
        ImageSize { height: frame.height.min(side), width: frame.width.min(side) }
    }

    pub(super) fn validate(&self, frame: ImageSize) -> Result<(), EngineError> {
        let least = self.weights.net().min_side_px();
        let part = self.part_of(frame);
        let checks = [
            (
                "lambda_lpips",
                f64::from(self.lambda),
                self.lambda.is_finite() && self.lambda >= 0.0,
                "0 or more".to_owned(),
            ),
            ("lpips_every", f64::from(self.every), self.every > 0, "at least 1".to_owned()),
            (
                "side of what LPIPS compares",
                part.height.min(part.width) as f64,
                part.height.min(part.width) >= least,
                format!("at least {least} px for {}", self.weights.net()),
            ),
        ];
        for (what, got, fine, expected) in checks {
            if !fine {
                return Err(EngineError::Usage { what: what.to_owned(), got: got.to_string(), expected });
            }
        }
        Ok(())
    }
}

fn name_of_weights<S: Serializer>(weights: &Arc<LpipsWeights>, serializer: S) -> Result<S::Ok, S::Error> {
    weights.as_ref().serialize(serializer)
}
