//! One leak, traced: how far the right copies stand out, and who else does.

use std::time::Instant;

use guard4d_engine::base::prf::{MasterSecret, Prf};
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::asset::gather_asset;
use guard4d_engine::fingerprint::estimate::{Estimate, Uncoded, estimate};
use guard4d_engine::fingerprint::film::Exposures;
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::fingerprint::power::unspoilt_score;
use guard4d_engine::fingerprint::seen::Seen;
use guard4d_engine::fingerprint::shot::Shot;
use guard4d_engine::fingerprint::trace::{DECOY_BINS, Decoys, Scorer};
use guard4d_engine::scene::Model;
use guard4d_kernels::Device;
use serde::{Deserialize, Serialize};

use super::film::Spoilt;

/// Copies that a family p-value is for.
const FAMILY: f64 = 1e6;
/// Copies that are scored beside the right ones.
const OTHERS: u64 = 20_000;
/// Copies that were never made.
const DECOYS: u64 = 20_000;

/// Keys that a film is read by which shows nobody's copy, and copies of each.
const WRONG_KEYS: u8 = 100;
const OTHERS_BY_KEY: u64 = 1000;

/// What was found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// The model's name.
    pub asset: String,
    /// Number of the key.
    pub key: u8,
    /// What leaked.
    pub leak: String,
    /// What it was filmed as; `asset` where it was not.
    pub film: String,
    /// Frames of the film.
    pub frames: u32,
    /// PSNR that was asked for, dB.
    pub asked_db: f64,
    /// PSNR of the filmed copy before it was encoded, dB.
    pub psnr_db: f64,
    /// Copies that contributed.
    pub contributed: usize,
    /// Score of the best of them, in deviations by chance.
    pub t: f64,
    /// Of the least.
    pub t_least: f64,
    /// How many of them are named among a million copies at 1e-6.
    pub named: usize,
    /// Bound on the p-value of the best, for a million copies, as a decimal logarithm.
    pub log10_p: f64,
    /// Keys that it was read by.
    pub keys_tried: usize,
    /// Of 20,000 others, or 1000 of each key: the best score.
    pub t_other: f64,
    /// How many of those would be named.
    pub wrong: usize,
    /// Score of the chips that all copies share.
    pub t_shared: f64,
    /// What is left of the mark, as a share of what a copy that nothing was done to would score.
    pub gain: f64,
    /// Mean and mean square of decoys' scores.
    pub decoy_mean: f64,
    /// See `decoy_mean`.
    pub decoy_variance: f64,
    /// Of 20,000 decoys, how many score more than 2, 3 and 3.5 deviations, and how many the bound allows; empty for
    /// films of nobody's copy and in older tables.
    pub over_2: Option<u64>,
    /// See `over_2`.
    pub bound_2: Option<f64>,
    /// See `over_2`.
    pub over_3: Option<u64>,
    /// See `over_2`.
    pub bound_3: Option<f64>,
    /// See `over_2`.
    pub over_3_5: Option<u64>,
    /// See `over_2`.
    pub bound_3_5: Option<f64>,
    /// To gather, estimate and score, seconds.
    pub seconds: f64,
}

/// Reads a film by its cameras.
///
/// # Errors
/// When the device fails.
pub fn film(device: &Device, issue: &Issue<'_>, spoilt: &Spoilt, copies: &[u64]) -> Result<Reading, EngineError> {
    let started = Instant::now();
    let mut exposures = expose(device, issue.model(), spoilt)?;
    score(device, issue, &mut exposures, copies, started)
}

/// Reads a film that shows no copy of anybody's, by as many keys as are tried of each: that of the issue, and others.
///
/// # Errors
/// When the device fails.
pub fn innocent_film(device: &Device, issue: &Issue<'_>, spoilt: &Spoilt) -> Result<Reading, EngineError> {
    let started = Instant::now();
    let found = Uncoded::of(issue, &mut expose(device, issue.model(), spoilt)?)?;
    let mut reading = Reading { keys_tried: WRONG_KEYS.into(), t_other: f64::NEG_INFINITY, ..Reading::default() };
    for key in 0..WRONG_KEYS {
        let prf = Prf::new(&MasterSecret::from_bytes([key, 7].repeat(16).try_into().expect("32 bytes")));
        let issue = issue.by_another_key(prf);
        let Estimate { chips, .. } = found.for_issue(&issue);
        let scorer = Scorer::new(device, &issue, &chips)?;
        let best = scorer.best(1..OTHERS_BY_KEY + 1)?;
        reading.t_other = best.first().map_or(reading.t_other, |scored| reading.t_other.max(scored.score));
        // Bounds are for the copies that were looked at, and are asked for a million.
        let threshold = (1e-6 / FAMILY * OTHERS_BY_KEY as f64).ln();
        reading.wrong += best.iter().filter(|scored| scored.log_p_family <= threshold).count();
        let Decoys { mean, variance, .. } = scorer.decoys(OTHERS_BY_KEY)?;
        reading.decoy_mean += mean / f64::from(WRONG_KEYS);
        reading.decoy_variance += variance / f64::from(WRONG_KEYS);
    }
    reading.seconds = started.elapsed().as_secs_f64();
    Ok(reading)
}

/// What a film says, frame by frame.
pub(crate) fn expose(device: &Device, model: &Model, spoilt: &Spoilt) -> Result<Exposures, EngineError> {
    let mut exposures = Exposures::new(device, model.gaussians.len())?;
    let mut look = None;
    for (frame, &(camera, time)) in spoilt.frames.iter().zip(&spoilt.shots) {
        exposures.add_of_film(model, &Shot { frame, camera, time }, &mut look)?;
    }
    Ok(exposures)
}

/// Reads an asset.
///
/// # Errors
/// When the device fails.
pub fn asset(device: &Device, issue: &Issue<'_>, leaked: &Model, copies: &[u64]) -> Result<Reading, EngineError> {
    let started = Instant::now();
    let mut found = gather_asset(issue.model(), leaked)?;
    score(device, issue, &mut found, copies, started)
}

fn score(
    device: &Device,
    issue: &Issue<'_>,
    seen: &mut dyn Seen,
    copies: &[u64],
    started: Instant,
) -> Result<Reading, EngineError> {
    let Estimate { chips, noise } = estimate(issue, seen)?;
    let scorer = Scorer::new(device, issue, &chips)?;
    let seconds = started.elapsed().as_secs_f64();
    let code = issue.code();
    let chance = code.by_chance(&chips)?;
    let mut reading =
        Reading { contributed: copies.len(), keys_tried: 1, seconds, t_least: f64::INFINITY, ..Reading::default() };
    reading.t = f64::NEG_INFINITY;
    let threshold = (1e-6 / FAMILY).ln();
    for copy in copies {
        let score = code.score(&chips, &issue.copy_key(*copy))?;
        let (t, log_p) = (scorer.in_deviations(score), chance.log_tail(score).bound);
        reading.named += usize::from(log_p <= threshold);
        reading.t_least = reading.t_least.min(t);
        if t > reading.t {
            (reading.t, reading.log10_p) = (t, (log_p + FAMILY.ln()).min(0.0) / std::f64::consts::LN_10);
            reading.gain = score / unspoilt_score(issue, seen, noise)?;
        }
    }
    let best = scorer.best(1..OTHERS + 1)?;
    let required = scorer.required_score(threshold).unwrap_or(f64::INFINITY);
    reading.t_other = best.first().map_or(0.0, |scored| scored.score);
    reading.wrong = best.iter().filter(|scored| scored.score >= required).count();
    let shared = code.shared_score(&chips)?;
    reading.t_shared = shared.score / shared.chance.deviation();
    let decoys = scorer.decoys(DECOYS)?;
    (reading.decoy_mean, reading.decoy_variance) = (decoys.mean, decoys.variance);
    // Bins are half a deviation wide and go as far below 0 as above.
    let over = |half_deviations: usize| Some(decoys.counts[DECOY_BINS / 2 + half_deviations..].iter().sum::<u64>());
    let bound = |t: f64| Some(DECOYS as f64 * chance.log_tail(t * chance.deviation()).bound.exp());
    (reading.over_2, reading.bound_2) = (over(4), bound(2.0));
    (reading.over_3, reading.bound_3) = (over(6), bound(3.0));
    (reading.over_3_5, reading.bound_3_5) = (over(7), bound(3.5));
    Ok(reading)
}
