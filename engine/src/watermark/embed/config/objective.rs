//! What training makes small.

use clap::Args;
use serde::{Deserialize, Serialize};

use super::parse::{check, check_weight, range};
use super::terms::LpipsTerm;
use crate::error::EngineError;
use crate::picture::distortion::Distortion;

/// The loss: weights, and what frames pass through before they are read.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Quality")]
pub struct Objective {
    /// Train on distorted frames too: each of these as often as undistorted ones, as `guard4d attack --help` names them
    ///
    /// Strengths of noise, rotation, crop and brightness can be drawn between two numbers: rotation:-15..15. The
    /// fidelity is that of undistorted frames.
    #[arg(long = "distort", value_name = "NAME:STRENGTH", value_delimiter = ',')]
    #[arg(allow_hyphen_values = true)]
    pub distortions: Vec<Distortion>,
    /// Logit beyond which a bit is left alone; 0 takes the paper's cross-entropy
    #[arg(long, value_name = "LOGIT", hide = true)]
    pub margin: f32,
    /// Weight of the message loss and its controls (Guard4D: 0.03)
    #[arg(long, value_name = "WEIGHT", hide = true)]
    pub lambda_msg: f32,
    /// Weight of the reconstruction loss, L1 and 1 - SSIM (Guard4D: 1); where it is 0, the fidelity is held instead
    #[arg(long, value_name = "WEIGHT", hide = true)]
    pub lambda_recon: f32,
    /// Share of SSIM in the reconstruction loss (GuardSplat: 0.2)
    #[arg(long, value_name = "SHARE", hide = true)]
    pub lambda_ssim: f32,
    /// Weight of the offset penalty (Guard4D: 10)
    #[arg(long, value_name = "WEIGHT", hide = true)]
    pub lambda_offset: f32,
    /// Standard deviation of noise on unmarked clips, which the extractor's zero counts and `joint` has controls of;
    /// log-uniform between these
    #[arg(long, value_name = "LOW..HIGH", value_parser = range::<f32>, hide = true)]
    pub noise_sigma: (f32, f32),
    /// LPIPS, if a network for it was given
    #[arg(skip)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lpips: Option<LpipsTerm>,
}

impl Objective {
    /// Whether SSIM is part of the loss.
    pub(in super::super) fn uses_ssim(&self) -> bool {
        self.lambda_recon > 0.0 && self.lambda_ssim > 0.0
    }

    /// LPIPS, if it is part of the loss.
    pub(in super::super) fn trained_lpips(&self) -> Option<&LpipsTerm> {
        self.lpips.as_ref().filter(|term| term.lambda > 0.0)
    }

    /// Whether the loss has a part that looks at the pixels of whole frames.
    pub(in super::super) fn looks_at_pixels(&self) -> bool {
        self.lambda_recon > 0.0 || self.trained_lpips().is_some()
    }

    pub(super) fn validate(&self) -> Result<(), EngineError> {
        check_weight("margin", self.margin)?;
        check_weight("lambda_msg", self.lambda_msg)?;
        check_weight("lambda_recon", self.lambda_recon)?;
        check_weight("lambda_offset", self.lambda_offset)?;
        let share = self.lambda_ssim;
        check("lambda_ssim", share, (0.0..=1.0).contains(&share), "a share from 0 to 1")?;
        self.lpips.as_ref().map_or(Ok(()), LpipsTerm::validate)
    }
}
