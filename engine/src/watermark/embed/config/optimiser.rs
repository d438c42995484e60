//! How many steps are taken, and how large they are.

use clap::Args;
use serde::{Deserialize, Serialize};

use super::parse::{check, check_weight};
use crate::error::EngineError;

/// Steps between two evaluations of held-out clips: often enough to watch, seldom enough to cost little.
pub(super) const DEFAULT_HELD_OUT_EVERY: usize = 25;

/// Steps of Adam on the offsets.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Optimiser")]
pub struct Optimiser {
    /// Training steps, one clip each
    #[arg(long, value_name = "N", hide = true)]
    pub steps: usize,
    /// Adam's rate for DC offsets (paper: 0.005)
    #[arg(long, value_name = "RATE", hide = true)]
    pub lr_dc: f32,
    /// Rate of the other offsets as a share of that (GuardSplat: 0.05)
    #[arg(long, value_name = "SHARE", hide = true)]
    pub lr_rest_share: f32,
    /// Share of the rates that is left at the end of their cosine; 1 keeps them constant (paper)
    #[arg(long, value_name = "SHARE", hide = true)]
    pub lr_floor: f32,
    /// Steps between two evaluations of held-out clips; 0 for none. It changes no result, so that it is no part of
    /// what names one. A schedule has evaluations of its own instead.
    #[arg(skip = DEFAULT_HELD_OUT_EVERY)]
    #[serde(skip, default = "default_held_out_every")]
    pub held_out_every: usize,
}

fn default_held_out_every() -> usize {
    DEFAULT_HELD_OUT_EVERY
}

impl Optimiser {
    pub(super) fn validate(&self) -> Result<(), EngineError> {
        check("steps", self.steps, self.steps > 0, "at least 1")?;
        check_weight("lr_dc", self.lr_dc)?;
        check_weight("lr_rest_share", self.lr_rest_share)?;
        check_weight("lr_floor", self.lr_floor)
    }
}
