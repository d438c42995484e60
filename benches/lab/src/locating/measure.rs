//! One film, located: how far off that is.

use std::path::Path;
use std::time::Instant;

use guard4d_engine::error::EngineError;
use guard4d_engine::locate::film::{Located, locate};
use guard4d_engine::locate::gray::Gray;
use guard4d_engine::media::codec::Codec;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::{Frame, ReadOptions, read_clip};
use guard4d_engine::render::SceneRenderer;
use guard4d_engine::render::deform::DeformField;
use guard4d_engine::scene::{Camera, Model};
use guard4d_kernels::Device;
use serde::{Deserialize, Serialize};

use super::film::{Shots, seen};

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
    /// Width and height, px.
    pub width: u32,
    /// See `width`.
    pub height: u32,
    /// Frames.
    pub frames: usize,
    /// Whether it is said to be found.
    pub found: bool,
    /// Median over frames of the median reprojection error of visible splats, px.
    pub error_px: f64,
    /// Median error of the moment.
    pub error_time: f64,
    /// Share of frames that are within half a pixel.
    pub near: f64,
    /// Share of frames whose moment is within a 200th.
    pub near_time: f64,
    /// Median likeness of gradients.
    pub likeness: f64,
    /// To locate it, seconds.
    pub seconds: f64,
}

/// Films a model, encodes the film, and locates it in an original.
///
/// # Errors
/// When the device or ffmpeg fails.
pub fn film(
    device: &Device,
    shown: &Model,
    original: &Model,
    shots: &Shots,
    folder: &Path,
) -> Result<LocatedRow, EngineError> {
    let path = folder.join("film.mkv");
    let _ = std::fs::remove_file(&path);
    let options = EncodeOptions { codec: Some(Codec::H264), crf: Some(23), ..EncodeOptions::default() };
    write_video(&path, &draw(device, shown, shots)?, &options)?;
    let frames: Vec<Gray> = read_clip(&path, &ReadOptions::default())?.frames().iter().map(Gray::of_frame).collect();
    let started = Instant::now();
    let located = locate(device, original, &frames, &mut |_, _| Ok(()))?;
    let seconds = started.elapsed().as_secs_f64();
    let (camera, _) = shots[0];
    let row = LocatedRow {
        width: camera.width,
        height: camera.height,
        frames: frames.len(),
        seconds,
        ..LocatedRow::default()
    };
    match located {
        None => Ok(row),
        Some(located) => compare(device, original, shots, &located, row),
    }
}

fn compare(
    device: &Device,
    original: &Model,
    shots: &Shots,
    located: &[Located],
    row: LocatedRow,
) -> Result<LocatedRow, EngineError> {
    let mut field = DeformField::new(device, &original.gaussians, &original.motion)?;
    let (mut errors, mut times) = (Vec::new(), Vec::new());
    for ((camera, time), found) in shots.iter().zip(located) {
        let splats = field.at(*time)?.read()?;
        let stride = (splats.len() / SPLATS).max(1);
        let apart = splats.means.iter().step_by(stride).filter_map(|mean| {
            let point = glam::Vec3::from(*mean).as_dvec3();
            let (a, b) = (seen(camera, point)?, project(&found.camera, point)?);
            Some(f64::from((a[0] - b[0]).hypot(a[1] - b[1])))
        });
        errors.push(median(apart.collect()));
        times.push(f64::from((time - found.time).abs()));
    }
    let share = |errors: &[f64], near: f64| {
        errors.iter().filter(|error| **error <= near).count() as f64 / errors.len().max(1) as f64
    };
    Ok(LocatedRow {
        found: true,
        near: share(&errors, NEAR_PX),
        near_time: share(&times, NEAR_TIME),
        error_px: median(errors),
        error_time: median(times),
        likeness: median(located.iter().map(|located| located.likeness).collect()),
        ..row
    })
}

fn project(camera: &Camera, point: glam::DVec3) -> Option<[f32; 2]> {
    camera.project(point.as_vec3()).map(|(pixel, _)| pixel.to_array())
}

fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or(f64::INFINITY)
}

fn draw(device: &Device, model: &Model, shots: &Shots) -> Result<Vec<Frame>, EngineError> {
    let mut renderer = SceneRenderer::new(device, &model.gaussians, &model.motion, model.background)?;
    let mut frames = Vec::new();
    renderer.render_clips(std::slice::from_ref(shots), |_, camera, pixels| {
        frames.push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
        Ok(())
    })?;
    Ok(frames)
}
