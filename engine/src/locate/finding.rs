//! From a film to its cameras, and how sure they are.

use std::num::NonZeroU32;
use std::path::Path;

use serde::Serialize;

use super::film::{Locator, Track};
use super::gap::gap_px;
use super::reading::Reading;
use super::so_far::{Kept, SoFar};
use crate::base::digest::Digest;
use crate::base::numbers::median;
use crate::base::observer::{Observer, Progress};
use crate::error::EngineError;
use crate::media::ReadOptions;
use crate::media::framing::Rect;
use crate::render::making::Making;
use crate::scene::{CameraSet, Model};

/// Frames that are looked at where nobody says how many: twice as many as a film needs in which the mark is clear.
pub const DEFAULT_FRAMES: u32 = 96;

/// What the answer is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Locating {
    /// The asset is in the film, and from where it was taken is known.
    Located,
    /// It was not found.
    Inconclusive,
}

impl Locating {
    /// Process exit code.
    #[must_use]
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Located => 0,
            Self::Inconclusive => 4,
        }
    }
}

/// The answer, and how sure it is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LocateReport {
    /// The answer.
    pub verdict: Locating,
    /// Frames of the film.
    pub frames: usize,
    /// Those that were looked at, evenly spread.
    pub looked_at: usize,
    /// Those that were found.
    pub located: usize,
    /// Shots that they are of.
    pub shots: usize,
    /// Whether the film shows the asset as in a mirror.
    pub mirrored: bool,
    /// What part of the frames is the picture, where that is not all.
    pub picture: Option<Rect>,
    /// Median likeness of film and original in the frames that were found, or that of the likeliest guess where none
    /// was, −1 to 1: correlation of gradients where the original is drawn.
    pub likeness: Option<f64>,
    /// How far a frame is from between its neighbours at the median, px of the film; none of fewer than three frames.
    /// Each was fitted for itself, so that it is a bound on how far off they are where the camera moves evenly.
    pub apart_px: Option<f64>,
    /// How far apart a frame is found from those before it and from those behind it, px of the picture that was looked
    /// at, at the median of some: where pictures leave open where they were taken, that is far.
    pub gap_px: Option<f64>,
    /// Horizontal field of view at the median, degrees.
    pub fov_deg: Option<f64>,
    /// The first frame's moment and the last's.
    pub times: Option<[f64; 2]>,
    /// How it was made, where it was found.
    pub making: Option<Making>,
}

/// What came of a film.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// The camera of each frame; see [`Track::cameras`].
    pub cameras: Option<CameraSet>,
    /// The same in numbers.
    pub report: LocateReport,
}

/// What is looked at, and for what.
#[derive(Clone, Copy, Debug)]
pub struct Wanted<'a> {
    /// The locator's asset.
    pub model: &'a Model,
    /// The film.
    pub path: &'a Path,
    /// How it is read.
    pub options: &'a ReadOptions,
    /// Frames that are looked at, at most.
    pub most: NonZeroU32,
}

impl Locator {
    /// Finds where a film was taken. Where a place is given, what was found is kept there shot by shot.
    ///
    /// # Errors
    /// Those of reading it and of the device, and what the observer stops the work with; [`EngineError::BadData`] for
    /// what was kept of another film or original.
    pub fn film(
        &mut self,
        Wanted { model, path, options, most }: Wanted<'_>,
        kept: Option<Kept<'_>>,
        observer: &mut dyn Observer,
    ) -> Result<Finding, EngineError> {
        let mut read = 0;
        let reading = Reading::of(path, options, most, &mut || {
            read += 1;
            observer.observe(Progress { stage: "reading the film", done: read, total: None })
        })?;
        // Of the same pictures of another size, too.
        let identity = Digest::of(format!("{} {} {:?}", self.sought(), reading.digest(), reading.picture).as_bytes());
        let so_far = match kept {
            Some(Kept { path, goes_on: true }) => SoFar::read(path, identity)?,
            _ => SoFar::default(),
        };
        let mut keep = |so_far: &SoFar| kept.map_or(Ok(()), |kept| so_far.write(kept.path, identity));
        let track = self.locate_from(so_far, model, &reading.pictures, observer, &mut keep)?;
        let cameras = track.cameras(&reading)?;
        let mut gap = None;
        if track.is_found() {
            self.stage.draw_as(model, track.making)?;
            observer.observe(Progress { stage: "the other way round", done: 0, total: None })?;
            gap = gap_px(&mut self.stage, &reading.pictures, &track)?;
        }
        Ok(Finding { report: report(&track, &reading, gap), cameras })
    }
}

fn report(track: &Track, reading: &Reading, gap_px: Option<f64>) -> LocateReport {
    let known: Vec<_> = track.frames.iter().flatten().collect();
    let of = |number: &dyn Fn(usize) -> f64| (!known.is_empty()).then(|| median((0..known.len()).map(number)));
    let whole = Rect { x: 0, y: 0, width: reading.size.width(), height: reading.size.height() };
    let width = f64::from(reading.picture.width);
    let mut apart = Vec::new();
    for trio in track.shots.iter().flat_map(|shot| track.frames[shot.clone()].windows(3)) {
        if let [Some(before), Some(at), Some(behind)] = trio {
            apart.push(at.pose.apart_px(&before.pose.toward(&behind.pose, 0.5), width));
        }
    }
    LocateReport {
        verdict: if known.is_empty() { Locating::Inconclusive } else { Locating::Located },
        frames: reading.frames,
        looked_at: reading.pictures.len(),
        located: known.len(),
        shots: track.shots.len(),
        mirrored: track.is_mirrored,
        picture: Some(reading.picture).filter(|picture| *picture != whole),
        likeness: of(&|at| known[at].correlation).or(track.guess.map(|guess| guess.correlation)),
        apart_px: (!apart.is_empty()).then(|| median(apart.iter().copied())),
        gap_px,
        fov_deg: of(&|at| (2.0 * (0.5 / known[at].pose.lens.exp()).atan()).to_degrees()),
        times: known.first().zip(known.last()).map(|(first, last)| [first.pose.time, last.pose.time]),
        making: track.is_found().then_some(track.making),
    }
}
