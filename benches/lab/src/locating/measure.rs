//! One film, located: how far off that is.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::time::Instant;

use glam::{DVec2, DVec3};
use guard4d_engine::base::observer::Unobserved;
use guard4d_engine::base::output::{AtomicFile, Existing};
use guard4d_engine::error::EngineError;
use guard4d_engine::fingerprint::issue::Issue;
use guard4d_engine::locate::film::Locator;
use guard4d_engine::locate::reading::Reading;
use guard4d_engine::media::png::png_bytes;
use guard4d_engine::media::{Frame, ReadOptions};
use guard4d_engine::render::SceneRenderer;
use guard4d_engine::render::deform::DeformField;
use guard4d_engine::scene::{Camera, Gaussians, Model};
use guard4d_kernels::Device;
use serde::{Deserialize, Serialize};

use super::attack::Attack;
use super::film::{Shots, seen};
use super::picture::sheet;
use crate::tracing::film::Spoilt;
use crate::tracing::leak::LEAKED;
use crate::tracing::measure;

/// Errors up to which a frame counts as found, px and of the motion.
const NEAR_PX: f64 = 0.5;
const NEAR_TIME: f64 = 1.0 / 200.0;
/// Splats that are looked at, at most.
const SPLATS: usize = 2000;

/// What came of a film.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LocatedRow {
    /// The model's name.
    pub asset: String,
    /// Number of the film.
    pub film: u64,
    /// What was done to it.
    pub attack: String,
    /// Width and height, px.
    pub width: u32,
    /// See `width`.
    pub height: u32,
    /// Frames.
    pub frames: usize,
    /// Whether it is said to be found.
    pub found: bool,
    /// Median over frames of the median reprojection error of visible splats, px; none where it is not found.
    pub error_px: Option<f64>,
    /// Median error of the moment; none of an asset that stands still, either.
    pub error_time: Option<f64>,
    /// Share of frames that are within half a pixel.
    pub near: Option<f64>,
    /// Share of frames whose moment is within a 200th.
    pub near_time: Option<f64>,
    /// Median likeness of gradients, or that of the likeliest guess where nothing was found.
    pub likeness: f64,
    /// Frames that are said to be known.
    pub known: usize,
    /// Score of the copy by the true cameras, deviations.
    pub t_true: f64,
    /// By those that were found.
    pub t: f64,
    /// Whether it is named among a million by those.
    pub named: usize,
    /// Of 20,000 others, how many are.
    pub wrong: usize,
    /// To locate it, seconds.
    pub seconds: f64,
}

impl LocatedRow {
    /// Where its picture is kept.
    #[must_use]
    pub fn picture_in(&self, folder: &Path) -> PathBuf {
        folder.join(format!("{}-{}-{}.png", self.asset, self.film, self.attack))
    }
}

/// What is filmed, and what it is looked for in.
#[derive(Debug)]
pub struct Case<'a> {
    /// Device.
    pub device: &'a Device,
    /// The issue of the asset that is filmed.
    pub issue: &'a Issue<'a>,
    /// What is looked for in the film: the same asset, or another.
    pub sought: &'a Model,
    /// Base colours of the copy that leaks.
    pub leaked: &'a Gaussians,
    /// What is done to the film.
    pub attack: Attack,
    /// Folder for a picture of each film that is found.
    pub pictures: Option<&'a Path>,
}

/// Films a copy, encodes the film, locates it, and traces it by the cameras that are found and by the true ones; a row
/// that has its name is filled in.
///
/// # Errors
/// When the device or ffmpeg fails.
pub fn film(
    case: &Case<'_>,
    locator: &mut Locator,
    shots: &Shots,
    folder: &Path,
    named: LocatedRow,
) -> Result<LocatedRow, EngineError> {
    let Case { device, issue, sought, attack, .. } = *case;
    let spoilt = attack.apply(draw(case, shots)?, shots, folder)?;
    let path = folder.join("film.mkv");
    let started = Instant::now();
    let reading = Reading::of(&path, &ReadOptions::default(), NonZeroU32::MAX, &mut || Ok(()))?;
    let track = locator.locate(sought, &reading.pictures, &mut Unobserved)?;
    let (first, _) = spoilt.shots[0];
    let row = LocatedRow {
        likeness: track.guess.map_or(0.0, |guess| guess.correlation),
        width: first.width,
        height: first.height,
        frames: reading.frames,
        seconds: started.elapsed().as_secs_f64(),
        ..named
    };
    let cameras = track.cameras(&reading)?;
    let Some(cameras) = cameras.filter(|_| track.is_found()) else { return Ok(row) };
    let located = cameras.film();
    let row = compare(case, &spoilt, &cameras.clips().concat(), row)?;
    let pairs = spoilt.frames.iter().zip(&located).filter_map(|(frame, shot)| Some((frame.clone(), (*shot)?)));
    let (frames, shots) = pairs.unzip();
    let as_located = Spoilt { frames, shots };
    let [with_true, with_found] =
        [&attack.straightened(&spoilt)?, &as_located].map(|spoilt| measure::film(device, issue, spoilt, &[LEAKED]));
    let (with_true, with_found) = (with_true?, with_found?);
    if let Some((folder, sheet)) = case.pictures.zip(sheet(device, issue.model(), &as_located)?) {
        AtomicFile::write(&row.picture_in(folder), Existing::Replace, &png_bytes(&sheet))?;
    }
    Ok(LocatedRow {
        known: located.iter().flatten().count(),
        likeness: median(track.frames.iter().flatten().map(|fit| fit.correlation).collect()),
        t_true: with_true.t,
        t: with_found.t,
        named: with_found.named,
        wrong: with_found.wrong,
        ..row
    })
}

fn compare(
    case: &Case<'_>,
    spoilt: &Spoilt,
    located: &[(Camera, f32)],
    row: LocatedRow,
) -> Result<LocatedRow, EngineError> {
    let original = case.issue.model();
    let mut field = DeformField::new(case.device, &original.gaussians, &original.motion)?;
    let (mut errors, mut times) = (Vec::new(), Vec::new());
    for ((camera, time), (found, found_time)) in spoilt.shots.iter().zip(located) {
        let splats = field.at(*time)?.read()?;
        let stride = (splats.len() / SPLATS).max(1);
        let apart = splats.means.iter().step_by(stride).filter_map(|mean| {
            let point = glam::Vec3::from(*mean).as_dvec3();
            let place = case.attack.seen(camera, seen(camera, point)?);
            Some(place.distance(project(found, point)?))
        });
        errors.push(median(apart.collect()));
        times.push(f64::from((time - found_time).abs()));
    }
    let share = |errors: &[f64], near: f64| {
        errors.iter().filter(|error| **error <= near).count() as f64 / errors.len().max(1) as f64
    };
    let moves = !original.motion.is_still();
    Ok(LocatedRow {
        found: true,
        near: Some(share(&errors, NEAR_PX)),
        near_time: moves.then(|| share(&times, NEAR_TIME)),
        error_px: Some(median(errors)),
        error_time: moves.then(|| median(times)),
        ..row
    })
}

fn project(camera: &Camera, point: DVec3) -> Option<DVec2> {
    camera.project(point.as_vec3()).map(|(pixel, _)| pixel.as_dvec2())
}

fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or(f64::INFINITY)
}

fn draw(case: &Case<'_>, shots: &Shots) -> Result<Vec<Frame>, EngineError> {
    let model = case.issue.model();
    let mut renderer = SceneRenderer::new(case.device, case.leaked, &model.motion, model.background)?;
    let mut frames = Vec::new();
    renderer.render_clips(std::slice::from_ref(shots), |_, camera, pixels| {
        let mut pixels = pixels.to_vec();
        for (at, pixel) in pixels.chunks_exact_mut(4).enumerate() {
            let width = camera.width as usize;
            if let Some(behind) = case.attack.background([at % width, at / width]) {
                for channel in 0..3 {
                    pixel[channel] += pixel[3] * (behind[channel] - model.background[channel]);
                }
            }
        }
        frames.push(Frame::from_rgba32f(camera.width, camera.height, &pixels)?);
        Ok(())
    })?;
    Ok(frames)
}
