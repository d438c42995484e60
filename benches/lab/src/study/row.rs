//! One reading of one embedding, flat, as it stands in the tables.

use guard4d_engine::base::ledger::Ledger;
use guard4d_engine::evidence::control::{ChanceDeviation, ControlState};
use guard4d_engine::evidence::id_code::SearchedP;
use guard4d_engine::evidence::judgement::{PStatement, Verdict};
use guard4d_engine::evidence::thresholds::Thresholds;
use guard4d_engine::release::evaluate::Evaluation;
use guard4d_engine::watermark::embed::EmbedConfig;
use serde::{Deserialize, Serialize};

use super::plan::{Cell, Machine};
use crate::cross_examination::CrossExamination;

/// One reading of one embedding. All shares are of bits, from 0 to 1; empty is what was not measured.
///
/// A kept file may lack columns of figures that it has none of, and those that say the same in every row.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Names the embedding: a hash of all that decides it.
    pub embedding: String,
    /// What was read: see [`super::Take`].
    pub take: String,
    /// Scene.
    pub scene: String,
    /// What was done to the scene first.
    pub variant: String,
    /// Seed of key, message, views, times and noise.
    pub seed: u64,
    /// Profile of the settings.
    pub profile: String,
    /// Extractor.
    pub mode: String,
    /// Message bits.
    pub bits: u32,
    /// How CLIP's matrices are kept.
    pub precision: String,
    /// Side of frames, pixels.
    pub size_px: u32,
    /// Training clips.
    pub views: u32,
    /// Steps asked for.
    pub max_steps: usize,
    /// Steps taken.
    pub steps: Option<usize>,
    /// Fidelity asked for, dB.
    pub target_db: f32,
    /// SH coefficients that have offsets.
    pub bases: String,
    /// Offsets that are not zero.
    pub offsets: Option<usize>,
    /// Clips read.
    pub clips: Option<usize>,
    /// Message bits right in marked clips.
    pub marked: Option<f64>,
    /// The same, frame by frame.
    pub frames: Option<f64>,
    /// Clips read without a wrong bit.
    pub exact: Option<f64>,
    /// Clips that each prove the message alone.
    pub proven: Option<f64>,
    /// The message's bits in clean clips.
    pub clean: Option<f64>,
    /// Whether that is inside the two-sided 99 % band.
    pub clean_in_band: Option<bool>,
    /// How far the bit that clean clips agree on most is from one half of them.
    pub clean_bit_bias: Option<f64>,
    /// The message's bits in clean clips with noise.
    pub noisy: Option<f64>,
    /// Whether that is inside the band.
    pub noisy_in_band: Option<bool>,
    /// Whole-frame PSNR of the mark, 8-bit against float, mean over views, dB.
    pub psnr_db: Option<f64>,
    /// The same over the object's pixels.
    pub object_psnr_db: Option<f64>,
    /// CIEDE2000 over the object's pixels, mean.
    pub colour_mean: Option<f64>,
    /// The same, exceeded by one pixel in twenty.
    pub colour_p95: Option<f64>,
    /// SSIM.
    pub ssim: Option<f64>,
    /// LPIPS, with a network for it.
    pub lpips: Option<f64>,
    /// Exact p-value of all clips together, from their matching bits; empty for `joint`, which has none.
    pub p_value: Option<f64>,
    /// The same from the soft score, by which `verify` decides.
    pub p_soft: Option<f64>,
    /// What `verify` would say of all clips together.
    #[serde(default)]
    pub verdict: String,
    /// The message's bits in unmarked clips of other scenes.
    pub other_scenes: Option<f64>,
    /// Whether that is inside the band.
    pub other_scenes_in_band: Option<bool>,
    /// Another key's own message in the marked clips.
    pub wrong_key_own: Option<f64>,
    /// The message's bits in the marked clips, read by R as it was before it saw the message.
    pub untrained: Option<f64>,
    /// Message swap: the second message's bits in a second copy, optimised through the first copy's frozen extractor.
    pub swap_second: Option<f64>,
    /// The first message's bits there.
    pub swap_first: Option<f64>,
    /// The message's bits in clips of the same asset as another owner marked it.
    pub other_owner: Option<f64>,
    /// Whether that is inside the band.
    pub other_owner_in_band: Option<bool>,
    /// The message's bits that an R which was trained afterwards says of unmarked clips.
    pub forged: Option<f64>,
    /// What `verify` would say of that.
    #[serde(default)]
    pub forged_verdict: String,
    /// Seconds of planning.
    pub plan_s: Option<f64>,
    /// Seconds of fitting.
    pub fit_s: Option<f64>,
    /// Seconds of training.
    pub train_s: Option<f64>,
    /// Seconds of the embedding.
    pub wall_s: Option<f64>,
    /// Seconds of all processor cores in it.
    pub cpu_s: Option<f64>,
    /// Most device memory taken, MiB.
    pub peak_mib: Option<f64>,
    /// Why there is no reading.
    #[serde(default)]
    pub error: String,
    /// Load of the machine before.
    #[serde(default)]
    pub load: String,
    /// Device.
    #[serde(default)]
    pub device: String,
    /// Version of the program.
    #[serde(default)]
    pub version: String,
}

/// What an embedding took.
#[derive(Clone, Copy, Debug)]
pub(super) struct Effort {
    pub(super) steps: usize,
    pub(super) offsets: usize,
    /// Planning, fitting, training.
    pub(super) stages: [f64; 3],
    pub(super) wall_s: f64,
    pub(super) cpu_s: f64,
    pub(super) peak_bytes: u64,
}

impl Row {
    /// What is known before anything is measured.
    pub(super) fn of(cell: &Cell, machine: &Machine) -> Self {
        let EmbedConfig { profile, views, fidelity, optimiser, seed, .. } = &cell.arm.config;
        Self {
            embedding: cell.id(machine),
            scene: cell.scene.to_string(),
            variant: cell.arm.variant.to_string(),
            seed: *seed,
            profile: words(profile),
            mode: cell.arm.config.mode().to_string(),
            bits: cell.arm.bits,
            precision: cell.arm.precision.name().to_owned(),
            size_px: views.size_px.0,
            views: views.clips,
            max_steps: optimiser.steps,
            target_db: fidelity.target_psnr,
            bases: format!("{:?}", fidelity.bases).to_lowercase(),
            load: load(),
            device: machine.device.clone(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            ..Self::default()
        }
    }

    /// Adds what the embedding took.
    pub(super) fn took(self, effort: &Effort) -> Self {
        let [plan, fit, train] = effort.stages.map(Some);
        Self {
            steps: Some(effort.steps),
            offsets: Some(effort.offsets),
            plan_s: plan,
            fit_s: fit,
            train_s: train,
            wall_s: Some(effort.wall_s),
            cpu_s: Some(effort.cpu_s),
            peak_mib: Some(effort.peak_bytes as f64 / f64::from(1 << 20)),
            ..self
        }
    }

    /// Adds what one take said.
    pub(super) fn read(self, take: String, e: &Evaluation) -> Self {
        let quiet = |chance_deviation: &ChanceDeviation| Some(chance_deviation.state == ControlState::Quiet);
        Self {
            take,
            clips: Some(e.clips),
            marked: Some(e.marked),
            frames: Some(e.marked_frames),
            exact: Some(e.exact() as f64 / e.clips.max(1) as f64),
            proven: Some(e.proven(Thresholds::for_bits(e.bits).fpr)),
            clean: Some(e.clean),
            clean_in_band: quiet(&e.clean_leak),
            clean_bit_bias: Some(e.clean_bits.max_deviation),
            noisy: Some(e.noisy),
            noisy_in_band: quiet(&e.noisy_leak),
            psnr_db: Some(e.psnr.mean_of_views_db.0),
            object_psnr_db: Some(e.foreground_psnr.mean_of_views_db.0),
            colour_mean: Some(e.colour_difference.mean),
            colour_p95: Some(e.colour_difference.p95),
            ssim: Some(e.ssim),
            lpips: e.lpips,
            ..self
        }
    }

    /// Adds what witnesses said.
    pub(super) fn examined(self, x: &CrossExamination) -> Self {
        let (p_value, p_soft) = match &x.evidence.p_value {
            PStatement::Exact { matches, soft_score } | PStatement::Searched(SearchedP { matches, soft_score, .. }) => {
                (Some(*matches), Some(*soft_score))
            }
            PStatement::NotCommitted(_) | PStatement::Empirical { .. } => (None, None),
        };
        Self {
            p_value,
            p_soft,
            verdict: in_words(x.evidence.verdict),
            other_scenes: x.other_scenes.as_ref().map(ChanceDeviation::share),
            other_scenes_in_band: x.other_scenes.as_ref().map(|deviation| deviation.state == ControlState::Quiet),
            wrong_key_own: Some(x.wrong_key_own.share()),
            untrained: x.untrained.as_ref().map(ChanceDeviation::share),
            ..self
        }
    }

    /// Whether all clips together prove the message, by `verify`'s test and at its rate.
    pub(super) fn is_read(&self) -> bool {
        self.p_soft.is_some_and(|p| p <= Thresholds::for_bits(self.bits as usize).fpr)
    }

    /// The newest row of an embedding's reading.
    pub(super) fn newest<'a>(ledger: &'a Ledger<Self>, embedding: &str, take: &str) -> Option<&'a Self> {
        ledger.newest(|row| row.embedding == embedding && row.take == take)
    }
}

/// A verdict as files have it.
pub(super) fn in_words(verdict: Verdict) -> String {
    words(&verdict)
}

/// A unit variant as files name it.
fn words(value: &impl Serialize) -> String {
    let json = serde_json::to_value(value).unwrap_or_default();
    json.as_str().unwrap_or_default().to_owned()
}

/// Load averages of the machine, where it tells them.
fn load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split(' ').take(2).collect::<Vec<_>>().join(" ")
}
