//! Whose copy is it: what films show, against every copy of an issue, with a verdict.

use std::path::Path;

use guard4d_kernels::Device;
use serde::Serialize;

use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::evidence::score_tail::ScoreTail;
use crate::fingerprint::asset;
use crate::fingerprint::estimate::{Estimate, estimate};
use crate::fingerprint::film::{Exposures, Shot};
use crate::fingerprint::issue::Issue;
use crate::fingerprint::power::unspoilt_score;
use crate::fingerprint::seen::Seen;
use crate::fingerprint::trace::{Decoys, Scored, Scorer};
use crate::media::{Frame, FrameSource};
use crate::release::ledger::Ledger;
use crate::scene::{Camera, CameraSet, FrameSize, Model};

/// A family of false accusations in so many is borne unless something else is asked.
pub const DEFAULT_FPR: f64 = 1e-6;
/// Copies that were never made, scored for comparison.
const DECOYS: u64 = 10_000;
/// What is left of a mark in the worst film that a copy is still asked to be found in, as a share of the score.
const LEAST_GAIN: f64 = 0.08;
/// Standard deviations by which such a film would have to be over the threshold, before silence is taken for an answer.
const MARGIN: f64 = 3.0;
/// How far the shapes of frames and cameras may differ, as a share: sides are rounded to whole, even pixels.
const SHAPE: f64 = 0.01;
/// Splats of a leaked asset that have to be found again, for it to be asked at all.
const FEWEST_SPLATS: usize = 16;
/// Pixels of frames that are estimated together: 100 frames of 400 px, some 400 MB with what draws them again.
const PIXELS_AT_ONCE: usize = 1 << 24;

/// What the answer is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Tracing {
    /// At least one copy contributed.
    Traced,
    /// No copy of this issue: one would have been found.
    None,
    /// Too little is seen to say either.
    Inconclusive,
}

impl Tracing {
    /// Process exit code.
    #[must_use]
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Traced => 0,
            Self::None => 1,
            Self::Inconclusive => 4,
        }
    }
}

/// A copy that is named.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Named {
    /// Who got it; none where the ledger does not say.
    pub recipient: Option<String>,
    /// Its number.
    pub copy: u64,
    /// Bound on the probability that any copy scores so high by chance.
    pub p_family: f64,
    /// Decimal logarithm of it, which does not become 0.
    pub log10_p_family: f64,
    /// The same by the saddle point, which proves nothing.
    pub log10_p_estimate: f64,
    /// Standard deviations above chance.
    pub score: f64,
}

/// What the chips say that all copies share.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SharedClaim {
    /// Bound on the probability that they agree so well by chance.
    pub p: f64,
    /// Decimal logarithm of it.
    pub log10_p: f64,
    /// Standard deviations above chance.
    pub score: f64,
}

/// The answer, and what it rests on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// The answer.
    pub verdict: Tracing,
    /// Who is named, best first.
    pub copies: Vec<Named>,
    /// Whether it is of this issue at all.
    pub owner: SharedClaim,
    /// Copies that were looked at, which the p-values are multiplied by.
    pub copies_scored: u64,
    /// Readings that were tried, which they are multiplied by too.
    pub hypotheses: u64,
    /// Frames that were read; none of an asset.
    pub frames: u64,
    /// Largest p-value that names a copy.
    pub fpr: f64,
    /// The best score of all copies, named or not.
    pub best_score: f64,
    /// The score that names a copy; none where no score could.
    pub required_score: Option<f64>,
    /// Where nobody is named: what a copy would have scored at the mean in the worst film that is still asked of.
    pub least_expected_score: Option<f64>,
    /// What copies score that were never made.
    pub decoys: Decoys,
}

/// What is asked.
#[derive(Debug)]
pub struct TraceRequest<'a> {
    /// Device.
    pub device: &'a Device,
    /// The issue, of the ledger's terms and the original.
    pub issue: &'a Issue<'a>,
    /// Who got what.
    pub ledger: &'a Ledger,
    /// Copies to score, from number 1 on; at least those of the ledger.
    pub copies: u64,
    /// Largest p-value that names a copy.
    pub fpr: f64,
}

/// A film and its cameras.
#[derive(Debug)]
pub struct KnownFilm<'a> {
    /// Where it is, for messages.
    pub path: &'a Path,
    /// Its frames.
    pub source: &'a FrameSource,
    /// The camera and time of each frame, in its order.
    pub shots: Vec<(Camera, f32)>,
}

/// What leaks say of each chip.
pub struct Gathered {
    /// Estimates of all parts, added up.
    chips: Vec<f64>,
    frames: u64,
    /// The part that was estimated last, which stands for the others, and how many there are.
    last: Box<dyn Seen>,
    noise: f64,
    parts: u32,
}

impl std::fmt::Debug for Gathered {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Gathered").field("frames", &self.frames).finish_non_exhaustive()
    }
}

impl<'a> KnownFilm<'a> {
    /// A film with its cameras, which are brought to the size of its frames.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for cameras of another shape than the frames; those of reading one.
    pub fn new(path: &'a Path, source: &'a FrameSource, cameras: &CameraSet) -> Result<Self, EngineError> {
        let (width, height) = source.size_px()?;
        let size = FrameSize::new(width, height)?;
        let mut shots = cameras.clips().concat();
        for (camera, _) in &mut shots {
            let stretched = f64::from(width) * f64::from(camera.height) / (f64::from(height) * f64::from(camera.width));
            if (stretched - 1.0).abs() > SHAPE {
                let got = format!("{}x{} pixels", camera.width, camera.height);
                let expected = format!("the shape of {width}x{height}, as the frames of {} have", path.display());
                return Err(EngineError::Usage { what: "cameras of the film".to_owned(), got, expected });
            }
            *camera = camera.resized(size);
        }
        Ok(Self { path, source, shots })
    }

    fn wrong_number(&self, frames: &str) -> EngineError {
        EngineError::Usage {
            what: format!("cameras of {}", self.path.display()),
            got: self.shots.len().to_string(),
            expected: format!("one for each of {frames} frames"),
        }
    }
}

/// Gathers what films say, of which `each` is told frame by frame.
///
/// # Errors
/// [`EngineError::Usage`] for more or fewer cameras than frames; those of reading and of the device.
pub fn gather(
    device: &Device,
    issue: &Issue<'_>,
    films: &[KnownFilm<'_>],
    each: &mut dyn FnMut() -> Result<(), EngineError>,
) -> Result<Gathered, EngineError> {
    let mut exposures = Exposures::new(device, issue.model())?;
    let mut all = Parts { chips: vec![0.0; issue.code().positions().len()], noise: 0.0, count: 0 };
    let mut frames = 0;
    for film in films {
        if let Some(expected) = film.source.expected_frames().filter(|n| *n != film.shots.len() as u64) {
            return Err(film.wrong_number(&expected.to_string()));
        }
        let mut shots = film.shots.iter();
        let mut detail = None;
        film.source.for_each(&mut |frame: Frame| {
            each()?;
            let &(camera, time) = shots.next().ok_or_else(|| film.wrong_number("more"))?;
            frames += 1;
            if exposures.pixels() > PIXELS_AT_ONCE {
                all.add(issue, &mut exposures)?;
                exposures.clear();
            }
            exposures.add_of_film(&Shot { frame: &frame, camera, time }, &mut detail)
        })?;
        if shots.len() > 0 {
            return Err(film.wrong_number("fewer"));
        }
    }
    all.add(issue, &mut exposures)?;
    let Parts { chips, noise, count } = all;
    Ok(Gathered { chips, frames, last: Box::new(exposures), noise, parts: count })
}

/// Gathers what a leaked asset says.
///
/// # Errors
/// [`EngineError::BadData`] where hardly a splat of it is one of the original's.
pub fn gather_asset(issue: &Issue<'_>, path: &Path, leaked: &Model) -> Result<Gathered, EngineError> {
    let mut found = asset::gather_asset(issue.model(), leaked)?;
    if found.matched < FEWEST_SPLATS {
        let got = format!("{} that are the original's", found.matched);
        return Err(bad_data(path, "splats", got, format!("at least {FEWEST_SPLATS}, of this asset")));
    }
    let Estimate { chips, noise } = estimate(issue, &mut found)?;
    Ok(Gathered { chips, frames: 0, last: Box::new(found), noise, parts: 1 })
}

/// Estimates of parts of a leak.
struct Parts {
    chips: Vec<f64>,
    noise: f64,
    count: u32,
}

impl Parts {
    fn add(&mut self, issue: &Issue<'_>, seen: &mut dyn Seen) -> Result<(), EngineError> {
        let Estimate { chips, noise } = estimate(issue, seen)?;
        self.chips.iter_mut().zip(chips).for_each(|(sum, chip)| *sum += chip);
        self.noise = noise;
        self.count += 1;
        Ok(())
    }
}

/// Scores every copy, and says who is named.
///
/// # Errors
/// Those of scoring, and of the ledger.
pub fn judge(request: &TraceRequest<'_>, gathered: &mut Gathered) -> Result<Report, EngineError> {
    let TraceRequest { device, issue, ledger, fpr, .. } = *request;
    let evidence = &gathered.chips;
    let scorer = Scorer::new(device, issue, evidence)?;
    let copies_scored = request.copies.max(ledger.last_number()?).max(1);
    let best = scorer.best(1..copies_scored + 1)?;
    let log_fpr = fpr.ln();
    let named = best.iter().filter(|scored| scored.log_p_family <= log_fpr);
    let copies = named.map(|scored| name(ledger, scored)).collect::<Result<Vec<_>, _>>()?;
    let required = scorer.required_score(log_fpr - (copies_scored as f64).ln());
    let mut least_expected = None;
    if copies.is_empty() {
        let unspoilt = f64::from(gathered.parts) * unspoilt_score(issue, &mut *gathered.last, gathered.noise)?;
        least_expected = Some(scorer.in_deviations(LEAST_GAIN * unspoilt));
    }
    let is_power_enough = required.zip(least_expected).is_some_and(|(required, t)| t >= required + MARGIN);
    let shared = issue.code().shared_score(evidence)?;
    let owner = claim(shared.score, &shared.chance);
    let is_of_issue = owner.log10_p <= fpr.log10();
    Ok(Report {
        verdict: match (copies.is_empty(), is_power_enough && !is_of_issue) {
            (false, _) => Tracing::Traced,
            (true, true) => Tracing::None,
            (true, false) => Tracing::Inconclusive,
        },
        copies,
        owner,
        copies_scored,
        hypotheses: 1,
        frames: gathered.frames,
        fpr,
        best_score: best.first().map_or(0.0, |scored| scored.score),
        required_score: required,
        least_expected_score: least_expected,
        decoys: scorer.decoys(DECOYS)?,
    })
}

fn name(ledger: &Ledger, scored: &Scored) -> Result<Named, EngineError> {
    let [log10_p_family, log10_p_estimate] =
        [scored.log_p_family, scored.log_p_estimate].map(|log_p| log_p / std::f64::consts::LN_10);
    Ok(Named {
        recipient: ledger.of_number(scored.copy)?.map(|record| record.recipient),
        copy: scored.copy,
        p_family: scored.log_p_family.exp(),
        log10_p_family,
        log10_p_estimate,
        score: scored.score,
    })
}

fn claim(score: f64, chance: &ScoreTail) -> SharedClaim {
    let log_p = chance.log_tail(score).bound;
    let score = if score == 0.0 { 0.0 } else { score / chance.deviation() };
    SharedClaim { p: log_p.exp(), log10_p: log_p / std::f64::consts::LN_10, score }
}
