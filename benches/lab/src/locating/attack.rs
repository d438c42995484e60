//! What is done to films before somebody looks for their cameras.

use std::path::Path;

use clap::ValueEnum;
use glam::DVec2;
use guard4d_engine::base::numbers::narrow;
use guard4d_engine::error::EngineError;
use guard4d_engine::media::codec::Codec;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::framing::Rect;
use guard4d_engine::media::{Frame, ReadOptions, read_clip};
use guard4d_engine::scene::{Camera, FrameSize};

use super::film::Shots;
use super::screen::Screen;
use crate::tracing::film::{Spoilt, changed};

/// Share of the sides that is kept, and how much of the rest is cut off before it.
const CROPPED: f64 = 0.7;
const CUT_BEFORE: f64 = 0.4;
/// A bar's share of the height.
const BAR: f64 = 0.12;
/// A side of the logo, of the frame's: a twentieth of the area.
const LOGO: f64 = 0.2236;

/// What is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Attack {
    /// H.264 at CRF 23, as all that follow.
    None,
    /// At CRF 35.
    Crf35,
    /// Half of each side.
    Half,
    /// Seven tenths of each side.
    Crop,
    /// Black bars above and below.
    Letterbox,
    /// Left and right exchanged.
    Mirror,
    /// A fifth brighter.
    Brighter,
    /// A fifth darker.
    Darker,
    /// Contrast a fifth less.
    Flatter,
    /// Contrast a fifth more.
    Harder,
    /// Levels to a power of 1.2.
    Gamma,
    /// Each fourth frame twice.
    Repeated,
    /// Each fourth frame left out.
    Dropped,
    /// A logo over a twentieth of the frame.
    Logo,
    /// Another background, with a pattern.
    Background,
    /// Filmed once more from a screen, a little from the side.
    Screen,
}

impl Attack {
    /// As tables name it.
    ///
    /// # Panics
    /// Never: none is hidden.
    #[must_use]
    pub fn name(self) -> String {
        self.to_possible_value().expect("none is hidden").get_name().to_owned()
    }

    /// Films that are spoilt, encoded and decoded, with the camera and moment of each frame.
    ///
    /// # Errors
    /// When ffmpeg fails.
    pub fn apply(self, frames: Vec<Frame>, shots: &Shots, folder: &Path) -> Result<Spoilt, EngineError> {
        let Spoilt { frames, shots } = self.edited(frames, shots.clone())?;
        let path = folder.join("film.mkv");
        let crf = if self == Self::Crf35 { 35 } else { 23 };
        let options = EncodeOptions { codec: Some(Codec::H264), crf: Some(crf), ..EncodeOptions::default() };
        let _ = std::fs::remove_file(&path);
        write_video(&path, &frames, &options)?;
        let frames = read_clip(&path, &ReadOptions::default())?.frames().to_vec();
        Ok(Spoilt { frames, shots })
    }

    fn edited(self, frames: Vec<Frame>, mut shots: Shots) -> Result<Spoilt, EngineError> {
        let Some(first) = frames.first() else { return Ok(Spoilt { frames, shots }) };
        let (width, height) = (first.width(), first.height());
        type Edited = Result<Frame, EngineError>;
        let each = |edit: &dyn Fn(&Frame) -> Edited| frames.iter().map(edit).collect::<Result<Vec<_>, EngineError>>();
        let frames: Vec<Frame> = match self {
            Self::None | Self::Crf35 | Self::Background => frames,
            Self::Half => {
                let size = FrameSize::new(even(f64::from(width) / 2.0), even(f64::from(height) / 2.0))?;
                shots.iter_mut().for_each(|(camera, _)| *camera = camera.resized(size));
                each(&|frame| frame.resized((size.width(), size.height())))?
            }
            Self::Crop => {
                let kept = |side: u32| even(CROPPED * f64::from(side));
                let before = |side: u32| even(CUT_BEFORE * f64::from(side - kept(side)));
                let rect = Rect { x: before(width), y: before(height), width: kept(width), height: kept(height) };
                shots.iter_mut().for_each(|(camera, _)| *camera = cropped(*camera, rect));
                each(&|frame| frame.cut(rect))?
            }
            Self::Letterbox => {
                let bar = even(BAR * f64::from(height));
                for (camera, _) in &mut shots {
                    camera.cy += narrow(f64::from(bar));
                    camera.height += 2 * bar;
                }
                each(&|frame| boxed(frame, bar))?
            }
            Self::Mirror => {
                shots.iter_mut().for_each(|(camera, _)| *camera = camera.mirrored());
                each(&|frame| {
                    let rows = frame.rgb().chunks_exact(3 * width as usize);
                    Frame::new(
                        width,
                        height,
                        rows.flat_map(|row| row.chunks_exact(3).rev().flatten().copied()).collect(),
                    )
                })?
            }
            Self::Brighter => changed(&frames, |level| 1.2 * level)?,
            Self::Darker => changed(&frames, |level| 0.8 * level)?,
            Self::Flatter => changed(&frames, |level| 0.5 + 0.8 * (level - 0.5))?,
            Self::Harder => changed(&frames, |level| 0.5 + 1.2 * (level - 0.5))?,
            Self::Gamma => changed(&frames, |level| level.powf(1.2))?,
            Self::Repeated => {
                let order: Vec<usize> =
                    (0..frames.len()).flat_map(|at| vec![at; 1 + usize::from(at % 4 == 3)]).collect();
                shots = order.iter().map(|at| shots[*at]).collect();
                order.iter().map(|at| frames[*at].clone()).collect()
            }
            Self::Dropped => {
                let kept = |at: &usize| at % 4 != 3;
                shots = (0..frames.len()).filter(kept).map(|at| shots[at]).collect();
                (0..frames.len()).filter(kept).map(|at| frames[at].clone()).collect()
            }
            Self::Logo => each(&|frame| with_logo(frame))?,
            Self::Screen => each(&|frame| Screen::of(width, height).recorded(frame))?,
        };
        Ok(Spoilt { frames, shots })
    }

    /// Where a place that a camera sees is in the film, px.
    #[must_use]
    pub fn seen(self, camera: &Camera, place: DVec2) -> DVec2 {
        if self == Self::Screen { Screen::of(camera.width, camera.height).seen(place) } else { place }
    }

    /// A film as its cameras took it: without the slant of a screen.
    ///
    /// # Errors
    /// Never for frames that were read.
    pub fn straightened(self, film: &Spoilt) -> Result<Spoilt, EngineError> {
        let straight = |frame: &Frame| match self {
            Self::Screen => Screen::of(frame.width(), frame.height()).undone(frame),
            _ => Ok(frame.clone()),
        };
        let frames = film.frames.iter().map(straight).collect::<Result<_, _>>()?;
        Ok(Spoilt { frames, shots: film.shots.clone() })
    }

    /// What is behind the asset at a pixel, where that is not its own background.
    #[must_use]
    pub fn background(self, [x, y]: [usize; 2]) -> Option<[f32; 3]> {
        let [a, b] = [x, y].map(|side| (side as f32 / 17.0).sin());
        (self == Self::Background).then_some([0.45 + 0.2 * a, 0.5 + 0.2 * b, 0.6 - 0.1 * a * b])
    }
}

fn cropped(camera: Camera, rect: Rect) -> Camera {
    let [x, y] = [rect.x, rect.y].map(|side| narrow(f64::from(side)));
    Camera { cx: camera.cx - x, cy: camera.cy - y, width: rect.width, height: rect.height, ..camera }
}

fn boxed(frame: &Frame, bar: u32) -> Result<Frame, EngineError> {
    let black = vec![0; 3 * (frame.width() * bar) as usize];
    Frame::new(frame.width(), frame.height() + 2 * bar, [&black, frame.rgb(), &black].concat())
}

fn with_logo(frame: &Frame) -> Result<Frame, EngineError> {
    let (width, height) = (frame.width() as usize, frame.height() as usize);
    let [across, down] = [width, height].map(|side| even(LOGO * side as f64) as usize);
    let mut rgb = frame.rgb().to_vec();
    for y in 0..down {
        for x in 0..across {
            let is_letter = (x / 12 + y / 9) % 2 == 0;
            let at = 3 * ((height - down + y) * width + width - across + x);
            rgb[at..at + 3].copy_from_slice(if is_letter { &[240, 240, 240] } else { &[200, 30, 40] });
        }
    }
    Frame::new(frame.width(), frame.height(), rgb)
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a side of a frame")]
fn even(side: f64) -> u32 {
    (2 * (side / 2.0).round() as u32).max(2)
}
