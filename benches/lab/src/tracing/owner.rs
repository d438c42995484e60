//! How well an owner's marks are read: a delivered asset, filmed from each class of cameras. The chips by the key and
//! by others; the message by itself, and beside the original.

use std::path::Path;
use std::time::Instant;

use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::detect::comparer::Comparer;
use guard4d_engine::error::EngineError;
use guard4d_engine::evidence;
use guard4d_engine::evidence::id_code::SearchedP;
use guard4d_engine::evidence::message::Message;
use guard4d_engine::fingerprint::code::{Code, SharedScore};
use guard4d_engine::fingerprint::estimate::estimate;
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::fingerprint::shot::Shot;
use guard4d_engine::scene::Model;
use guard4d_engine::watermark::embed::TrainingViews;
use guard4d_engine::watermark::extractor::reader::Reader;
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
    /// Bits of the message.
    pub bits: u32,
    /// Bits right in the film by itself.
    pub alone: u32,
    /// Their p-value by the soft score.
    pub alone_p: f64,
    /// Bits right beside the original.
    pub beside: u32,
    /// Their p-value by the soft score.
    pub beside_p: f64,
    /// To compare, and to read that, seconds.
    pub beside_seconds: f64,
}

/// What reads the message.
#[derive(Debug)]
pub struct Reading<'a> {
    /// The extractor.
    pub reader: &'a mut Reader,
    /// How training looked at the asset.
    pub views: &'a TrainingViews,
    /// What was embedded.
    pub message: Message,
}

/// An asset as it was handed out.
#[derive(Debug)]
pub struct Delivered<'a> {
    /// The original with its chips, as the receipt has them.
    pub issue: &'a Issue<'a>,
    /// What was handed out.
    pub marked: &'a Model,
}

/// Films an asset, and reads its marks.
///
/// # Errors
/// When the device or ffmpeg fails.
pub fn read(
    device: &Device,
    delivered: &Delivered<'_>,
    reading: &mut Reading<'_>,
    film: Film,
    size: Size,
    folder: &Path,
) -> Result<ChipsRow, EngineError> {
    let Delivered { issue, marked } = delivered;
    let filmed = Filmed::new(device, issue.model(), &marked.gaussians, film, size)?;
    let spoilt = spoil(device, &film, &filmed.frames, &filmed.shots, folder)?;
    let row =
        ChipsRow { film: film.name.to_owned(), frames: size.frames, psnr_db: filmed.psnr_db, ..ChipsRow::default() };
    let row = message(device, issue.model(), &spoilt, reading, row)?;
    score(device, issue, &spoilt, row)
}

/// The message by itself, and beside the original.
fn message(
    device: &Device,
    original: &Model,
    spoilt: &Spoilt,
    reading: &mut Reading<'_>,
    row: ChipsRow,
) -> Result<ChipsRow, EngineError> {
    let Reading { reader, views, message } = reading;
    let bits = message.num_bits();
    let said = |logits: &[f32]| {
        let read = evidence::reading::Reading::from_logits(logits, bits)?;
        Ok::<_, EngineError>((read.matches(message)?, SearchedP::of(&read, message, 1)?.soft_score))
    };
    let (alone, alone_p) = said(&reader.logits(&spoilt.frames)?)?;
    let started = Instant::now();
    let mut comparer = Comparer::new(device, original, views)?;
    for (frame, &(camera, time)) in spoilt.frames.iter().zip(&spoilt.shots) {
        comparer.push(reader, &Shot { frame, camera, time })?;
    }
    comparer.next_film(reader)?;
    let (beside, beside_p) = said(&comparer.into_logits())?;
    Ok(ChipsRow { bits, alone, alone_p, beside, beside_p, beside_seconds: started.elapsed().as_secs_f64(), ..row })
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
