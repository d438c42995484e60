//! How faint a mark is, and where it may be.

use clap::Args;
use guard4d_kernels::shape::OffsetBases;
use serde::{Deserialize, Serialize};

use super::bases;
use super::parse::{check, check_weight};
use crate::error::EngineError;
use crate::scene::gaussians::{MAX_SH_BASES, Y0, sh_bases};

/// Least fidelity that an embedding can be held to, dB: a hold that never binds.
pub(super) const UNBOUND_PSNR: f32 = 20.0;

/// What offsets may do to the picture.
#[derive(Args, Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[command(next_help_heading = "Quality")]
pub struct Fidelity {
    /// Fidelity to hold at least, in dB over whole frames; marks are as strong as it allows, to within a few dB
    ///
    /// Rates, colour levels and the largest offset follow it where nothing else says what they are.
    #[arg(long, value_name = "DB")]
    pub target_psnr: f32,
    /// Fidelity at the start, dB; the hold tightens linearly over the first half of the steps
    #[arg(long, value_name = "DB", hide = true)]
    pub start_psnr: f32,
    /// SH coefficients to write into: `dc`, the base colour alone, survives formats that drop the rest; with `all` of
    /// the model's degree the mark also turns with the view
    #[arg(long, value_name = "BASES", value_parser = bases::parse, hide = true)]
    #[serde(with = "bases")]
    pub bases: OffsetBases,
    /// Most that an offset may be, as a change of its splat's colour from 0 to 1: less is harder to see, and survives
    /// less; without it the fidelity alone bounds offsets
    ///
    /// Where not all 16 coefficients of degree 3 have offsets, they may be larger by the root of 16 over their number.
    #[arg(long, value_name = "COLOUR", hide = true)]
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_offset: Option<f32>,
    /// Change only the splats that together carry this share of the light in the training views, the fewest that do: 1
    /// all, 0.9 far fewer
    #[arg(long, value_name = "SHARE", hide = true)]
    pub visibility_share: f32,
    /// How much of the fidelity the owner's chips take, dB; 0 writes none
    ///
    /// They prove the asset from any camera, see `verify --original --cameras`. The mark keeps that much more.
    #[arg(long, value_name = "DB", hide = true)]
    #[serde(default)]
    pub chips_db: f32,
}

/// Most that the owner's chips may take, dB: half of the error.
const MOST_CHIPS_DB: f32 = 3.0;
/// Fidelity of the owner's chips at least, dB, however little is asked for: they are no stronger than a copy's.
const FAINTEST_CHIPS_PSNR: f64 = 49.0;

impl Fidelity {
    /// The fidelity that the mark is held to in training, dB, so that what is asked for is left beside the chips.
    #[must_use]
    pub(in super::super) fn of_mark(&self, asked: f32) -> f32 {
        asked + self.chips_db
    }

    /// The fidelity of the owner's chips alone, dB; none where none are written.
    ///
    /// # Equation
    /// Errors add up: 10^(−asked/10) = 10^(−(asked + chips)/10) + 10^(−PSNR/10).
    #[must_use]
    pub fn chips_psnr(&self) -> Option<f64> {
        let (asked, chips) = (f64::from(self.target_psnr), f64::from(self.chips_db));
        let share = 1.0 - 10f64.powf(-0.1 * chips);
        (chips > 0.0).then(|| (asked - 10.0 * share.log10()).max(FAINTEST_CHIPS_PSNR))
    }

    /// Most that the offset of a coefficient of a model of this degree may be, if there is a bound.
    ///
    /// # Equation: √(16/B) `max_offset` / Y₀
    /// for B coefficients with offsets. The sum of the squares of all bases is the same in every direction, so that the
    /// root of the mean square of what offsets at their bounds add to a colour is the same for every B. With the bound
    /// of 16 the DC terms alone came out at 56 dB, and read 81 % of single frames' bits; with four times as much 48 dB
    /// and 85 % (demo, 16 bits, one key).
    #[must_use]
    pub fn largest_offset(&self, sh_degree: u32) -> Option<f64> {
        let used = match self.bases {
            OffsetBases::Dc => sh_bases(0),
            OffsetBases::All => sh_bases(sh_degree),
        };
        self.max_offset.map(|colour| (MAX_SH_BASES as f64 / used as f64).sqrt() * f64::from(colour) / Y0)
    }

    pub(super) fn validate(&self) -> Result<(), EngineError> {
        let psnr = self.target_psnr;
        check("target PSNR", psnr, (UNBOUND_PSNR..=80.0).contains(&psnr), "20 to 80 dB")?;
        check_weight("max_offset", self.max_offset.unwrap_or(0.0))?;
        let share = self.visibility_share;
        check("visibility_share", share, share > 0.0 && share <= 1.0, "more than 0, and at most 1")?;
        check("chips_db", self.chips_db, (0.0..=MOST_CHIPS_DB).contains(&self.chips_db), "0 to 3 dB")
    }
}
