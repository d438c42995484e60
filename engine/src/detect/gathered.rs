//! What films whose cameras are known, or a leaked asset, say of each chip.

use std::path::Path;

use guard4d_kernels::Device;
use serde::Serialize;

use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::fingerprint::asset;
use crate::fingerprint::code::SharedScore;
use crate::fingerprint::drawing::Look;
use crate::fingerprint::estimate::{Estimate, estimate};
use crate::fingerprint::film::Exposures;
use crate::fingerprint::issue::Issue;
use crate::fingerprint::seen::Seen;
use crate::fingerprint::shot::Shot;
use crate::locate::finding::LocateReport;
use crate::media::{Frame, FrameSource};
use crate::render::settings::Settings;
use crate::scene::{Camera, CameraSet, FrameSize, Model};

/// How far the shapes of frames and cameras may differ, as a share: sides are rounded to whole, even pixels.
const SHAPE: f64 = 0.01;
/// Splats of a leaked asset that have to be found again, for it to be asked at all.
const FEWEST_SPLATS: usize = 16;
/// Pixels of frames that are estimated together: 100 frames of 400 px, some 400 MB with what draws them again.
const PIXELS_AT_ONCE: usize = 1 << 24;

/// A film and its cameras.
#[derive(Debug)]
pub struct KnownFilm<'a> {
    /// Where it is, for messages.
    pub path: &'a Path,
    /// Its frames.
    pub source: &'a FrameSource,
    /// The camera and time of each frame, in its order; none of frames that are not read.
    pub shots: Vec<Option<(Camera, f32)>>,
}

/// What leaks say of each chip.
pub struct Gathered {
    /// Estimates of all parts, added up.
    pub(super) chips: Vec<f64>,
    pub(super) frames: u64,
    /// The part that was estimated last, which stands for the others, and how many there are.
    pub(super) last: Box<dyn Seen>,
    pub(super) noise: f64,
    pub(super) parts: u32,
    /// How each film was drawn, as far as that shows.
    pub looks: Vec<DrawnAs>,
    /// How the cameras of films were found, where nobody gave them.
    pub located: Vec<LocateReport>,
}

/// How a film was drawn: as its first frame is least different from the unmarked asset.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DrawnAs {
    /// Whose renderer, and how it was set: as `render --as`, `--dilation` and `--sh-degree` take it.
    #[serde(flatten)]
    pub settings: Settings,
    /// Whether it was made half as large afterwards.
    pub made_smaller: bool,
    /// What stands behind the asset: red, green and blue, 0 to 1.
    pub background: [f32; 3],
}

impl DrawnAs {
    fn of(Look { making, background }: Look) -> Self {
        Self { settings: making.settings, made_smaller: making.times > 1, background }
    }
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

impl Gathered {
    /// What the shared chips of an issue say of it.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for chips of another issue.
    pub fn shared(&self, issue: &Issue<'_>) -> Result<SharedClaim, EngineError> {
        let SharedScore { score, chance } = issue.code().shared_score(&self.chips)?;
        let log_p = chance.log_tail(score).bound;
        let score = if score == 0.0 { 0.0 } else { score / chance.deviation() };
        Ok(SharedClaim { p: log_p.exp(), log10_p: log_p / std::f64::consts::LN_10, score })
    }
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
        let mut shots = cameras.film();
        for (camera, _) in shots.iter_mut().flatten() {
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

    /// Goes through the film's frames; none where a frame's camera is not known.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for more or fewer cameras than frames; those of reading and of `each`.
    pub(super) fn for_each_shot(
        &self,
        each: &mut dyn FnMut(Option<&Shot<'_>>) -> Result<(), EngineError>,
    ) -> Result<(), EngineError> {
        if let Some(expected) = self.source.expected_frames().filter(|n| *n != self.shots.len() as u64) {
            return Err(self.wrong_number(&expected.to_string()));
        }
        let mut shots = self.shots.iter();
        self.source.for_each(&mut |frame: Frame| {
            let shot = shots.next().ok_or_else(|| self.wrong_number("more"))?;
            let shot = shot.map(|(camera, time)| Shot { frame: &frame, camera, time });
            each(shot.as_ref())
        })?;
        if shots.len() > 0 { Err(self.wrong_number("fewer")) } else { Ok(()) }
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
    let mut exposures = Exposures::new(device, issue.model().gaussians.len())?;
    let mut all = Parts { chips: vec![0.0; issue.code().positions().len()], noise: 0.0, count: 0 };
    let (mut frames, mut looks) = (0, Vec::new());
    for film in films {
        let mut look = None;
        film.for_each_shot(&mut |shot| {
            each()?;
            let Some(shot) = shot else { return Ok(()) };
            frames += 1;
            if exposures.pixels() > PIXELS_AT_ONCE {
                all.add(issue, &mut exposures)?;
                exposures.clear();
            }
            exposures.add_of_film(issue.model(), shot, &mut look)
        })?;
        looks.extend(look.map(DrawnAs::of));
    }
    all.add(issue, &mut exposures)?;
    let Parts { chips, noise, count } = all;
    Ok(Gathered { chips, frames, last: Box::new(exposures), noise, parts: count, looks, located: Vec::new() })
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
    Ok(Gathered { chips, frames: 0, last: Box::new(found), noise, parts: 1, looks: Vec::new(), located: Vec::new() })
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
