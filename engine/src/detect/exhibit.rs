//! Frames that were read, to be shown beside a verdict, and what the original looks like there.

use guard4d_kernels::Device;

use super::gathered::KnownFilm;
use crate::base::spread::spread;
use crate::error::EngineError;
use crate::media::Frame;
use crate::picture::metrics::{Decibels, Picture, SquaredError};
use crate::render::SceneRenderer;
use crate::scene::Model;

/// Frames of a clip that are shown.
const OF_CLIP: usize = 3;
/// Frames that are shown in all.
const OF_ALL: usize = 3;
/// What differs between pictures is shown so many times as large, about this level.
const DIFFERENCE: i16 = 4;
const GREY: i16 = 128;
/// From here on a picture is the same view of the same thing: marks and compression leave 30 to 50 dB, another camera
/// less than 25.
const SAME_VIEW_DB: f64 = 30.0;

/// A frame of a suspect clip as it was read.
#[derive(Clone, Debug)]
pub struct Exhibit {
    /// The clip's name.
    pub clip: String,
    /// Its number among the frames read, from 0.
    pub frame: u64,
    /// What it shows.
    pub picture: Frame,
}

/// The frame of the original that is nearest to another picture.
#[derive(Clone, Debug)]
pub struct Nearest {
    /// Number of the view.
    pub view: usize,
    /// Number of the frame in it.
    pub frame: usize,
    /// What it shows, as large as the other picture.
    pub picture: Frame,
    /// How near it is.
    pub psnr: Decibels,
}

/// A frame of a film whose cameras are known, and what the original looks like from there.
#[derive(Clone, Debug)]
pub struct Beside {
    /// Of the film.
    pub film: Exhibit,
    /// The original, as large.
    pub original: Frame,
}

impl Beside {
    /// Some frames of films.
    ///
    /// # Errors
    /// Those of reading films and of the device.
    pub fn of(device: &Device, model: &Model, films: &[KnownFilm<'_>]) -> Result<Vec<Self>, EngineError> {
        let mut renderer = SceneRenderer::new(device, &model.gaussians, &model.motion, model.background)?;
        let mut all = Vec::new();
        for film in films {
            let known = (0u64..).zip(&film.shots).filter_map(|(at, shot)| Some((at, (*shot)?)));
            let wanted = spread_out(known.collect(), OF_CLIP);
            let (mut number, mut pictures) = (0, Vec::new());
            film.source.for_each(&mut |frame: Frame| {
                pictures.extend(wanted.iter().any(|(at, _)| *at == number).then_some(frame));
                number += 1;
                Ok(())
            })?;
            let mut originals = Vec::new();
            renderer.render_clips(&[wanted.iter().map(|(_, shot)| *shot).collect()], |_, camera, pixels| {
                originals.push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
                Ok(())
            })?;
            let clip = film.path.display().to_string();
            let beside = |((frame, picture), original)| {
                let film = Exhibit { clip: clip.clone(), frame, picture };
                Self { film, original }
            };
            let numbers = wanted.iter().map(|(at, _)| *at);
            all.push(numbers.zip(pictures).zip(originals).map(beside).collect());
        }
        Ok(choose(all))
    }

    /// All in one picture, a row for each: the film, the original, and what differs, four times as much, on grey.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for what is larger than pictures may be, and for nothing.
    pub fn sheet(all: &[Self]) -> Result<Frame, EngineError> {
        let height: u32 = all.iter().map(|beside| beside.original.height()).sum();
        let width = 3 * all.iter().map(|beside| beside.original.width()).max().unwrap_or(0);
        let row = 3 * width as usize;
        let mut rgb = Vec::with_capacity(row * height as usize);
        for Self { film, original } in all {
            let line = 3 * original.width() as usize;
            let lines = film.picture.rgb().chunks_exact(line).zip(original.rgb().chunks_exact(line));
            for (film, original) in lines {
                let end = rgb.len() + row;
                let differ = |(film, original): (&u8, &u8)| {
                    let apart = DIFFERENCE * (i16::from(*film) - i16::from(*original));
                    u8::try_from((GREY + apart).clamp(0, 255)).unwrap_or(u8::MAX)
                };
                rgb.extend(film.iter().chain(original).copied());
                rgb.extend(film.iter().zip(original).map(differ));
                rgb.resize(end, 0);
            }
        }
        Frame::new(width, height, rgb)
    }

    /// How near both are.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for pictures of different sizes.
    pub fn psnr(&self) -> Result<Decibels, EngineError> {
        let pictures = [&self.film.picture, &self.original].map(Picture::from_frame);
        Ok(SquaredError::between(&pictures[0], &pictures[1])?.psnr())
    }
}

impl Exhibit {
    /// The frame among the original's `clean` views that this one looks most like; none without views.
    ///
    /// # Errors
    /// Never for frames that were read or rendered: all have a size.
    pub fn nearest(&self, clean: &[Vec<Frame>]) -> Result<Option<Nearest>, EngineError> {
        let size = (self.picture.width(), self.picture.height());
        let mut nearest: Option<Nearest> = None;
        for (view, frames) in clean.iter().enumerate() {
            for (number, frame) in frames.iter().enumerate() {
                let resized =
                    if (frame.width(), frame.height()) == size { frame.clone() } else { frame.resized(size)? };
                let near =
                    SquaredError::between(&Picture::from_frame(&self.picture), &Picture::from_frame(&resized))?.psnr();
                if nearest.as_ref().is_none_or(|best| near > best.psnr) {
                    nearest = Some(Nearest { view, frame: number, picture: resized, psnr: near });
                }
            }
        }
        Ok(nearest)
    }
}

impl Nearest {
    /// Whether it is the same view, so that what differs is worth looking at.
    #[must_use]
    pub fn is_same_view(&self) -> bool {
        self.psnr.0 >= SAME_VIEW_DB
    }
}

/// How `a` differs from `b`: the distance of each sample, `times` as large, up to white.
///
/// # Errors
/// [`EngineError::Usage`] for pictures of different sizes.
pub fn difference(a: &Frame, b: &Frame, times: u8) -> Result<Frame, EngineError> {
    if (a.width(), a.height()) != (b.width(), b.height()) {
        return Err(EngineError::Usage {
            what: "pictures to compare".to_owned(),
            got: format!("{} x {} px", b.width(), b.height()),
            expected: format!("{} x {} px", a.width(), a.height()),
        });
    }
    let samples = a.rgb().iter().zip(b.rgb()).map(|(a, b)| a.abs_diff(*b).saturating_mul(times));
    Frame::new(a.width(), a.height(), samples.collect())
}

/// Frames from all over a clip whose length nobody knows beforehand.
#[derive(Debug)]
pub(super) struct Album {
    frames: Vec<(u64, Frame)>,
    seen: u64,
    stride: u64,
}

impl Album {
    pub(super) fn new() -> Self {
        Self { frames: Vec::new(), seen: 0, stride: 1 }
    }

    /// Keeps a frame if it is one of the stride; with too many, every other one goes.
    pub(super) fn look(&mut self, frame: &Frame) {
        if self.seen.is_multiple_of(self.stride) {
            self.frames.push((self.seen, frame.clone()));
        }
        self.seen += 1;
        if self.frames.len() > 2 * OF_CLIP {
            self.stride *= 2;
            self.frames.retain(|(number, _)| number.is_multiple_of(self.stride));
        }
    }

    /// Some of them, from early to late.
    pub(super) fn close(self, clip: &str) -> Vec<Exhibit> {
        let exhibits =
            self.frames.into_iter().map(|(frame, picture)| Exhibit { clip: clip.to_owned(), frame, picture });
        spread_out(exhibits.collect(), OF_CLIP)
    }
}

/// The few to show of those of several clips: of as many clips as possible, the first ones.
pub(super) fn choose<T>(mut clips: Vec<Vec<T>>) -> Vec<T> {
    clips.truncate(OF_ALL);
    let count = clips.len().max(1);
    let of_each = |at: usize| OF_ALL / count + usize::from(at < OF_ALL % count);
    clips.into_iter().enumerate().flat_map(|(at, exhibits)| spread_out(exhibits, of_each(at))).collect()
}

/// At most `count` of them, the middles of as many equal parts.
fn spread_out<T>(all: Vec<T>, count: usize) -> Vec<T> {
    let chosen: Vec<usize> = spread(all.len(), count).collect();
    all.into_iter().enumerate().filter(|(at, _)| chosen.contains(at)).map(|(_, exhibit)| exhibit).collect()
}
