//! How well the owner's chips are read: a delivered asset, filmed from each class of cameras, by the key and by others.

use std::path::Path;
use std::time::Instant;

use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::code::{Code, SharedScore};
use guard4d_engine::fingerprint::estimate::estimate;
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::scene::Model;
use guard4d_kernels::Device;
use serde::{Deserialize, Serialize};

use super::film::{Film, Spoilt, spoil};
use super::filmed::{Filmed, Size};
use super::measure::expose;

/// Keys that had no part in it.
const OTHER_KEYS: u16 = 10_000;
/// Deviations above chance at which tails are counted.
const TAILS: [f64; 2] = [2.0, 3.0];

/// What was found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ChipsRow {
    /// The model's name.
    pub asset: String,
    /// What it was filmed as.
    pub film: String,
    /// Frames that were read.
    pub frames: u32,
    /// PSNR of all that was embedded, before the film was encoded, dB.
    pub psnr_db: f64,
    /// Score of the key, in deviations by chance.
    pub t: f64,
    /// Bound on its p-value, as a decimal logarithm.
    pub log10_p: f64,
    /// Mean and mean square of other keys' scores.
    pub other_mean: f64,
    /// See `other_mean`.
    pub other_variance: f64,
    /// Their best score.
    pub other_best: f64,
    /// Share of them that are two deviations above chance, and the bound on it.
    pub tail_2: f64,
    /// See `tail_2`.
    pub bound_2: f64,
    /// Three deviations.
    pub tail_3: f64,
    /// See `tail_3`.
    pub bound_3: f64,
    /// To gather, estimate and score, seconds.
    pub seconds: f64,
}

/// An asset as it was handed out.
#[derive(Debug)]
pub struct Delivered<'a> {
    /// The original with its chips, as the receipt has them.
    pub issue: &'a Issue<'a>,
    /// What was handed out.
    pub marked: &'a Model,
}

/// Films an asset, and reads its chips.
///
/// # Errors
/// When the device or ffmpeg fails.
pub fn read(
    device: &Device,
    delivered: &Delivered<'_>,
    film: Film,
    size: Size,
    folder: &Path,
) -> Result<ChipsRow, EngineError> {
    let Delivered { issue, marked } = delivered;
    let filmed = Filmed::new(device, issue.model(), &marked.gaussians, film, size)?;
    let spoilt = spoil(device, &film, &filmed.frames, &filmed.shots, folder)?;
    let row =
        ChipsRow { film: film.name.to_owned(), frames: size.frames, psnr_db: filmed.psnr_db, ..ChipsRow::default() };
    score(device, issue, &spoilt, row)
}

fn score(device: &Device, issue: &Issue<'_>, spoilt: &Spoilt, row: ChipsRow) -> Result<ChipsRow, EngineError> {
    let started = Instant::now();
    let chips = estimate(issue, &mut expose(device, issue.model(), spoilt)?)?.chips;
    let SharedScore { score, chance } = issue.code().shared_score(&chips)?;
    let deviation = chance.deviation();
    let log10 = |score: f64| chance.log_tail(score).bound / std::f64::consts::LN_10;
    let seconds = started.elapsed().as_secs_f64();
    let other = |key: u16| {
        let [low, high] = key.to_le_bytes();
        let prf = Prf::new(&MasterSecret::from_bytes([low, high].repeat(16).try_into().expect("32 bytes")));
        let code = Code::of_owner(&prf, issue.model().digest(), chips.len());
        code.shared_score(&chips).map(|other| other.score / deviation)
    };
    let others = (0..OTHER_KEYS).map(other).collect::<Result<Vec<f64>, _>>()?;
    let share = |of: &dyn Fn(f64) -> f64| others.iter().map(|t| of(*t)).sum::<f64>() / others.len() as f64;
    let tail = |least: f64| share(&|t| f64::from(u8::from(t >= least)));
    let [bound_2, bound_3] = TAILS.map(|t| 10f64.powf(log10(t * deviation)));
    Ok(ChipsRow {
        t: score / deviation,
        log10_p: log10(score),
        other_mean: share(&|t| t),
        other_variance: share(&|t| t * t),
        other_best: others.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        tail_2: tail(TAILS[0]),
        bound_2,
        tail_3: tail(TAILS[1]),
        bound_3,
        seconds,
        ..row
    })
}
