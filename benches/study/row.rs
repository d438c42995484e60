//! One measurement, and the columns that it fills.

use std::collections::BTreeMap;

use guard4d_engine::watermark::cross_examination::{CrossExamination, Swap};
use guard4d_engine::watermark::embed::{EmbedConfig, StepPart};
use guard4d_engine::watermark::evaluate::Evaluation;
use guard4d_engine::watermark::evidence::PStatement;
use guard4d_engine::watermark::metrics::PsnrSummary;
use guard4d_engine::watermark::null_panel::{ControlState, Leak};

use crate::ledger::Row;

/// Columns that tell one measurement from another; `settings` stands for all numbers of the embedding but the seed.
pub(crate) const IDENTITY: [&str; 6] = ["clip", "model", "bits", "seed", "settings", "rescaled_db"];

/// Source and machine of a run.
#[derive(Clone, Debug)]
pub(crate) struct Origin {
    pub(crate) commit: String,
    pub(crate) device: String,
    pub(crate) driver: String,
    pub(crate) processor: String,
    /// Hash of the CLIP checkpoint.
    pub(crate) clip: String,
}

/// A message swap: the second copy's readings and fidelity.
#[derive(Clone, Debug)]
pub(crate) struct SecondCopy {
    pub(crate) swap: Swap,
    pub(crate) psnr: PsnrSummary,
}

/// Everything that one row says.
pub(crate) struct Measured {
    pub(crate) origin: Origin,
    pub(crate) model: String,
    pub(crate) config: EmbedConfig,
    pub(crate) settings: String,
    /// The PSNR in dB that the mark's strength was chosen for; empty for its own.
    pub(crate) rescaled_to: String,
    /// Factor on the offsets.
    pub(crate) strength: f32,
    pub(crate) evaluation: Evaluation,
    pub(crate) examination: CrossExamination,
    pub(crate) second_copy: Option<SecondCopy>,
    pub(crate) steps: usize,
    pub(crate) seconds: BTreeMap<String, f64>,
    pub(crate) parts: BTreeMap<StepPart, f64>,
    pub(crate) load: String,
}

type Fill = Box<dyn Fn(&Measured) -> String>;

/// Name of the column with a part's device milliseconds per step.
pub(crate) fn part_column(part: StepPart) -> String {
    format!("{}_ms", part.name())
}

/// Every column with what fills it.
fn table() -> Vec<(String, Fill)> {
    let mut table: Vec<(String, Fill)> = Vec::new();
    let mut add = |name: &str, fill: fn(&Measured) -> String| table.push((name.to_owned(), Box::new(fill)));
    add("commit", |m| m.origin.commit.clone());
    add("device", |m| m.origin.device.clone());
    add("driver", |m| m.origin.driver.clone());
    add("processor", |m| m.origin.processor.clone());
    add("load", |m| m.load.clone());
    add("clip", |m| m.origin.clip.clone());
    add("model", |m| m.model.clone());
    add("mode", |m| m.config.mode.to_string());
    add("bits", |m| m.evaluation.bits.to_string());
    add("size_px", |m| format!("{}x{}", m.config.size_px.0, m.config.size_px.1));
    add("steps", |m| m.steps.to_string());
    add("seed", |m| m.config.seed.to_string());
    add("target_db", |m| m.config.target_psnr.to_string());
    add("rescaled_db", |m| m.rescaled_to.clone());
    add("strength", |m| format!("{:.4}", m.strength));
    add("settings", |m| m.settings.clone());
    add("psnr_db", |m| decibels(m.evaluation.psnr.mean_of_views_db.0));
    add("psnr_pooled_db", |m| decibels(m.evaluation.psnr.pooled_db.0));
    add("psnr_worst_db", |m| decibels(m.evaluation.psnr.min_db.0));
    add("object_psnr_db", |m| decibels(m.evaluation.foreground_psnr.mean_of_views_db.0));
    add("ssim", |m| format!("{:.5}", m.evaluation.ssim));
    add("clips", |m| m.evaluation.clips.to_string());
    add("marked", |m| share(m.evaluation.marked));
    add("marked_frames", |m| share(m.evaluation.marked_frames));
    add("clean", |m| share(m.evaluation.clean));
    add("clean_in_band", |m| in_band(&m.evaluation.clean_leak));
    add("noisy", |m| share(m.evaluation.noisy));
    add("noisy_in_band", |m| in_band(&m.evaluation.noisy_leak));
    add("band", |m| band(&m.evaluation.clean_leak));
    add("whole_matches", |m| m.examination.evidence.matches.to_string());
    add("p_kind", |m| p_value(m).0.to_owned());
    add("p_value", |m| format!("{:.3e}", p_value(m).1));
    add("verdict", |m| format!("{:?}", m.examination.evidence.verdict).to_lowercase());
    add("wrong_key", |m| share(m.examination.wrong_key.share()));
    add("wrong_key_own", |m| share(m.examination.wrong_key_own.share()));
    add("other_scenes", |m| optional(m.examination.other_scenes.as_ref().map(Leak::share)));
    add("other_scenes_in_band", |m| m.examination.other_scenes.as_ref().map(in_band).unwrap_or_default());
    add("untrained", |m| optional(m.examination.untrained.as_ref().map(Leak::share)));
    add("swap_second", |m| optional(m.second_copy.as_ref().map(|c| c.swap.second.share())));
    add("swap_first", |m| optional(m.second_copy.as_ref().map(|c| c.swap.first.share())));
    add("swap_psnr_db", |m| m.second_copy.as_ref().map(|c| decibels(c.psnr.mean_of_views_db.0)).unwrap_or_default());
    add("plan_s", |m| seconds(m, "plan"));
    add("fit_s", |m| seconds(m, "fit"));
    add("train_s", |m| seconds(m, "train"));
    add("step_s", |m| format!("{:.4}", m.seconds.get("train").map_or(f64::NAN, |s| s / m.steps as f64)));
    for part in StepPart::ALL {
        let fill = move |m: &Measured| format!("{:.3}", 1e3 * m.parts.get(&part).unwrap_or(&0.0) / m.steps as f64);
        table.push((part_column(part), Box::new(fill)));
    }
    table
}

/// Names of all columns.
pub(crate) fn columns() -> Vec<String> {
    table().into_iter().map(|(name, _)| name).collect()
}

impl Measured {
    /// Cells in the order of [`columns`].
    pub(crate) fn row(&self) -> Row {
        table().iter().map(|(_, fill)| fill(self)).collect()
    }
}

fn decibels(db: f64) -> String {
    format!("{db:.2}")
}

fn share(value: f64) -> String {
    format!("{value:.4}")
}

fn optional(value: Option<f64>) -> String {
    value.map(share).unwrap_or_default()
}

fn in_band(leak: &Leak) -> String {
    if leak.state == ControlState::Quiet { "yes" } else { "no" }.to_owned()
}

fn band(leak: &Leak) -> String {
    let bits = f64::from(leak.num_bits);
    format!("{:.4}-{:.4}", f64::from(leak.band_low) / bits, f64::from(leak.band_high) / bits)
}

/// Kind and value of what may be said about chance.
fn p_value(m: &Measured) -> (&'static str, f64) {
    match m.examination.evidence.p_value {
        PStatement::Exact { matches, .. } => ("exact", matches),
        PStatement::Searched(p) => ("bound after search", p.matches),
        PStatement::Empirical { bound, .. } => ("empirical bound", bound),
    }
}

fn seconds(m: &Measured, stage: &str) -> String {
    m.seconds.get(stage).map(|s| format!("{s:.2}")).unwrap_or_default()
}
