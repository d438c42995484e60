//! Films that copies leak in: from where, and what was done to them.

use std::path::Path;

use guard4d_engine::error::EngineError;
use guard4d_engine::media::codec::Codec;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::framing::Rect;
use guard4d_engine::media::{Frame, ReadOptions, read_clip};
use guard4d_engine::picture::distortion::DistortionChain;
use guard4d_engine::scene::camera::classes::CameraClass;
use guard4d_engine::scene::camera::paths::{Lens, USUAL_FOV_X_RAD};
use guard4d_engine::scene::{Camera, FrameSize, LookAt, Model};
use guard4d_kernels::Device;

/// Where between two moments a film's times lie, so that no other's are among them.
const BETWEEN: f32 = 0.37;

/// What is done to pictures before they are encoded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Edit {
    /// Nothing.
    None,
    /// A distortion that the engine knows, as `attack --apply` takes it.
    Distortion(&'static str),
    /// Each level to this power.
    Gamma(f64),
    /// Levels so many times as far from the middle.
    Contrast(f64),
    /// Half of each side.
    Half,
    /// Without the lowest tenth of the rows.
    FewerRows,
}

/// A film: from which cameras, edited how, through which codec.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Film {
    /// In tables.
    pub name: &'static str,
    /// From where.
    pub class: CameraClass,
    /// What is done to it first.
    pub edit: Edit,
    /// Codec and its quality; none for pictures.
    pub codec: Option<Coding>,
}

/// A codec at a quality.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coding {
    /// The codec.
    pub codec: Codec,
    /// Its quality.
    pub crf: u8,
}

const CRF_23: Option<Coding> = Some(Coding { codec: Codec::H264, crf: 23 });

const fn coded(name: &'static str, codec: Codec, crf: u8) -> Film {
    Film { name, class: CameraClass::Usual, edit: Edit::None, codec: Some(Coding { codec, crf }) }
}

const fn edited(name: &'static str, edit: Edit) -> Film {
    Film { name, class: CameraClass::Usual, edit, codec: CRF_23 }
}

const fn taken(name: &'static str, class: CameraClass) -> Film {
    Film { name, class, edit: Edit::None, codec: CRF_23 }
}

/// All films, those of the codecs first.
pub const FILMS: [Film; 26] = [
    Film { name: "png", class: CameraClass::Usual, edit: Edit::None, codec: None },
    coded("h264 23", Codec::H264, 23),
    coded("h264 28", Codec::H264, 28),
    coded("h264 35", Codec::H264, 35),
    coded("h265 28", Codec::H265, 28),
    coded("av1 45", Codec::Av1, 45),
    edited("half", Edit::Half),
    edited("brightness 0.8", Edit::Distortion("brightness:0.8")),
    edited("brightness 1.2", Edit::Distortion("brightness:1.2")),
    edited("contrast 0.8", Edit::Contrast(0.8)),
    edited("contrast 1.2", Edit::Contrast(1.2)),
    edited("gamma 0.8", Edit::Gamma(0.8)),
    edited("gamma 1.2", Edit::Gamma(1.2)),
    edited("jpeg 50", Edit::Distortion("jpeg:50")),
    edited("blur 1", Edit::Distortion("blur:1")),
    edited("noise 8", Edit::Distortion("noise:0.03137")),
    edited("rows", Edit::FewerRows),
    taken("above", CameraClass::Above),
    taken("below", CameraClass::Below),
    taken("near", CameraClass::Near),
    taken("far", CameraClass::Far),
    taken("wide", CameraClass::Wide),
    taken("narrow", CameraClass::Narrow),
    taken("portrait", CameraClass::Portrait),
    taken("off-centre", CameraClass::OffCentre),
    taken("roll", CameraClass::Roll),
];

/// So many frames of a class, at times of their own.
///
/// # Errors
/// For a size that is none.
pub fn shots(model: &Model, class: CameraClass, frames: u32, side_px: u32) -> Result<Vec<(Camera, f32)>, EngineError> {
    let lens = Lens { fov_x_rad: USUAL_FOV_X_RAD, size: FrameSize::new(side_px, side_px)? };
    let cameras = class.cameras(LookAt::of(model, USUAL_FOV_X_RAD), lens, frames)?;
    let time = |i: usize| (i as f32 + BETWEEN) / frames as f32;
    Ok(cameras.views.iter().enumerate().map(|(i, view)| (view.camera, time(i))).collect())
}

/// What came of frames.
#[derive(Clone, Debug)]
pub struct Spoilt {
    /// As they are decoded.
    pub frames: Vec<Frame>,
    /// The camera and time of each.
    pub shots: Vec<(Camera, f32)>,
}

/// What comes of frames: edited, encoded and decoded, with the cameras that they then have.
///
/// # Errors
/// When the device or ffmpeg fails.
pub fn spoil(
    device: &Device,
    film: &Film,
    frames: &[Frame],
    shots: &[(Camera, f32)],
    folder: &Path,
) -> Result<Spoilt, EngineError> {
    let (mut frames, mut shots) = (frames.to_vec(), shots.to_vec());
    let Some(first) = frames.first() else { return Ok(Spoilt { frames, shots }) };
    let (width, height) = (first.width(), first.height());
    match film.edit {
        Edit::None => {}
        Edit::Distortion(text) => {
            let chain = [text.parse().expect("a distortion that the engine knows")];
            let mut chain = DistortionChain::new(device, (width, height), &chain, 1)?;
            frames = frames.iter().zip(0..).map(|(frame, n)| chain.apply(frame, n)).collect::<Result<_, _>>()?;
        }
        Edit::Gamma(power) => frames = changed(&frames, |level| level.powf(power))?,
        Edit::Contrast(factor) => frames = changed(&frames, |level| 0.5 + factor * (level - 0.5))?,
        Edit::Half => {
            let size = FrameSize::new(width / 2, height / 2)?;
            frames = frames.iter().map(|frame| frame.resized((width / 2, height / 2))).collect::<Result<_, _>>()?;
            shots.iter_mut().for_each(|(camera, _)| *camera = camera.resized(size));
        }
        Edit::FewerRows => {
            let rect = Rect { x: 0, y: 0, width, height: height * 9 / 10 / 2 * 2 };
            frames = frames.iter().map(|frame| frame.clone().cut(rect)).collect::<Result<_, _>>()?;
            shots.iter_mut().for_each(|(camera, _)| camera.height = rect.height);
        }
    }
    if let Some(Coding { codec, crf }) = film.codec {
        let path = folder.join("film.mkv");
        let options = EncodeOptions { codec: Some(codec), crf: Some(crf), ..EncodeOptions::default() };
        write_video(&path, &frames, &options)?;
        frames = read_clip(&path, &ReadOptions::default())?.frames().to_vec();
        std::fs::remove_file(&path).map_err(|source| EngineError::Io { path, source })?;
    }
    Ok(Spoilt { frames, shots })
}

/// Frames with other levels, 0 to 1.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a level from 0 to 255")]
pub(crate) fn changed(frames: &[Frame], of: impl Fn(f64) -> f64) -> Result<Vec<Frame>, EngineError> {
    let table: Vec<u8> =
        (0..=255u8).map(|level| (255.0 * of(f64::from(level) / 255.0).clamp(0.0, 1.0)).round() as u8).collect();
    let change = |frame: &Frame| {
        let levels = frame.rgb().iter().map(|level| table[usize::from(*level)]).collect();
        Frame::new(frame.width(), frame.height(), levels)
    };
    frames.iter().map(change).collect()
}
