//! Clips from their first frame to their last through the extractor, wherever their frames come from.

use std::path::Path;

use guard4d_kernels::Device;
use guard4d_kernels::image::resize::ImageSize;

use super::comparer::Comparer;
use super::exhibit::{Album, Exhibit};
use super::gathered::KnownFilm;
use crate::base::observer::{Observer, Progress};
use crate::error::EngineError;
use crate::media::framing::{Framing, Rect};
use crate::media::{Frame, FrameSource, Integrity, ReadOptions};
use crate::picture::known_cameras::KnownCameras;
use crate::picture::part::{Framings, Part};
use crate::picture::settle::settle;
use crate::picture::undo_guess::UndoGuess;
use crate::render::SceneRenderer;
use crate::scene::{CameraSet, Model};
use crate::watermark::extractor::reader::{ClipFeatures, Reader};

/// Reads clips, and says how far it is. Of a video it never holds more frames than [`Reader`] looks at together.
pub(super) struct ClipReader<'a> {
    device: &'a Device,
    reader: Reader,
    num_bits: u32,
    options: &'a ReadOptions,
    observer: &'a mut dyn Observer,
}

/// What was seen in one clip.
pub(super) struct SeenClip {
    /// File, folder or view.
    pub(super) name: String,
    /// With each guess undone; at least one.
    pub(super) features: Vec<ClipFeatures>,
    /// How its frames were cut.
    pub(super) framings: Framings,
    /// Width and height of its frames.
    pub(super) size_px: (u32, u32),
    pub(super) integrity: Integrity,
    /// The part of its frames that was read, if not all.
    pub(super) cut: Option<Rect>,
    /// Some of its frames.
    pub(super) exhibits: Vec<Exhibit>,
}

impl<'a> ClipReader<'a> {
    /// Reads messages of `num_bits` bits with `reader`, and videos as `options` say.
    pub(super) fn new(
        device: &'a Device,
        reader: Reader,
        num_bits: u32,
        options: &'a ReadOptions,
        observer: &'a mut dyn Observer,
    ) -> Self {
        Self { device, reader, num_bits, options, observer }
    }

    /// Who watches.
    pub(super) fn observer(&mut self) -> &mut dyn Observer {
        &mut *self.observer
    }

    /// Bits of a message, `L`.
    pub(super) fn num_bits(&self) -> u32 {
        self.num_bits
    }

    /// A suspect video, in which the picture may have been framed anew; its frames are cut as its cameras say, where
    /// these are known.
    ///
    /// # Errors
    /// Those of [`FrameSource`] and of [`KnownCameras::parts`]; when the device fails; what the observer returns.
    pub(super) fn suspect_video(
        &mut self,
        path: &Path,
        cameras: Option<&KnownCameras>,
        guesses: &[UndoGuess],
    ) -> Result<SeenClip, EngineError> {
        self.video(path, self.options.framing, cameras, guesses)
    }

    /// How the frames of a suspect video would be cut.
    ///
    /// # Errors
    /// Those of [`FrameSource`]; what the observer returns.
    pub(super) fn video_framings(&mut self, path: &Path) -> Result<Framings, EngineError> {
        let source = FrameSource::open(path, self.options)?;
        let total = source.expected_frames();
        Ok(Framings::of(&self.parts(&source, &path.display().to_string(), total)?))
    }

    /// How frames in memory would be cut.
    pub(super) fn framings(&self, frames: &[Frame]) -> Framings {
        self.reader.known_views().map(|views| Framings::of(&views.parts(frames))).unwrap_or_default()
    }

    /// Features and logits of a video that is looked at as it is.
    ///
    /// # Errors
    /// Those of [`Self::suspect_video`].
    pub(super) fn plain_video(&mut self, path: &Path) -> Result<ClipFeatures, EngineError> {
        let clip = self.video(path, Framing::default(), None, &[UndoGuess::NONE])?;
        Ok(clip.features.into_iter().next().unwrap_or_default())
    }

    /// Compares the frames of a film whose cameras are known.
    ///
    /// # Errors
    /// Those of [`KnownFilm::for_each_shot`] and of [`Comparer::push`]; what the observer returns.
    pub(super) fn compare(&mut self, film: &KnownFilm<'_>, comparer: &mut Comparer<'_>) -> Result<(), EngineError> {
        let Self { reader, observer, .. } = self;
        let total = Some(film.shots.len() as u64);
        let mut done = 0;
        film.for_each_shot(&mut |shot| {
            done += 1;
            observer.observe(Progress { stage: "the message beside the original", done, total })?;
            shot.map_or(Ok(()), |shot| comparer.push(reader, shot))
        })?;
        comparer.next_film(reader)
    }

    /// Logits of frames in memory `[n, L]`.
    ///
    /// # Errors
    /// Those of [`Reader::look`].
    pub(super) fn logits(&mut self, frames: &[Frame]) -> Result<Vec<f32>, EngineError> {
        self.reader.logits(frames)
    }

    fn video(
        &mut self,
        path: &Path,
        framing: Framing,
        cameras: Option<&KnownCameras>,
        guesses: &[UndoGuess],
    ) -> Result<SeenClip, EngineError> {
        let source = FrameSource::open(path, &ReadOptions { framing, ..self.options.clone() })?;
        let (name, total) = (path.display().to_string(), source.expected_frames());
        let parts = match cameras {
            Some(cameras) => self.parts_by_cameras(&source, cameras)?,
            None => self.parts(&source, &name, total)?,
        };
        let framings = Framings::of(&parts);
        let (mut stream, mut album) = (self.reader.stream(guesses, parts), Album::new());
        let mut done = 0;
        let ending = source.for_each(&mut |frame| {
            album.look(&frame);
            stream.push(frame)?;
            done += 1;
            self.observer.observe(Progress { stage: &name, done, total })
        })?;
        let features = stream.finish()?;
        Ok(SeenClip {
            features,
            framings,
            size_px: ending.size_px,
            integrity: ending.integrity,
            cut: source.cut(),
            exhibits: album.close(&name),
            name,
        })
    }

    /// What of each frame is shown. Where that depends on the frames around it, a video is decoded once more for it.
    fn parts(&mut self, source: &FrameSource, name: &str, total: Option<u64>) -> Result<Vec<Part>, EngineError> {
        let Some(views) = self.reader.known_views() else { return Ok(Vec::new()) };
        let mut looks = Vec::new();
        let ending = source.for_each(&mut |frame| {
            looks.push(views.look(&frame));
            self.observer.observe(Progress { stage: name, done: looks.len() as u64, total })
        })?;
        let (width, height) = ending.size_px;
        Ok(settle(&looks, ImageSize { height: height as usize, width: width as usize }))
    }

    /// The same where cameras say it. A video is decoded once more, since they have to be as many as its frames.
    fn parts_by_cameras(&self, source: &FrameSource, cameras: &KnownCameras) -> Result<Vec<Part>, EngineError> {
        let mut frames = 0;
        let ending = source.for_each(&mut |_| {
            frames += 1;
            Ok(())
        })?;
        let (width, height) = ending.size_px;
        cameras.parts(frames, ImageSize { height: height as usize, width: width as usize })
    }

    /// Frames in memory.
    ///
    /// # Errors
    /// [`EngineError::Usage`] without a frame or with frames of different sizes; when the device fails; what the
    /// observer returns.
    pub(super) fn frames(
        &mut self,
        name: &str,
        frames: &[Frame],
        guesses: &[UndoGuess],
    ) -> Result<SeenClip, EngineError> {
        let first = frames.first().ok_or_else(|| no_frame(name))?;
        let parts = self.reader.parts(frames);
        let framings = self.reader.known_views().map(|_| Framings::of(&parts)).unwrap_or_default();
        let (mut stream, mut album) = (self.reader.stream(guesses, parts), Album::new());
        for (done, frame) in (1..).zip(frames) {
            album.look(frame);
            stream.push(frame.clone())?;
            self.observer.observe(Progress { stage: name, done, total: Some(frames.len() as u64) })?;
        }
        Ok(SeenClip {
            name: name.to_owned(),
            features: stream.finish()?,
            framings,
            size_px: (first.width(), first.height()),
            integrity: Integrity::Intact,
            cut: None,
            exhibits: album.close(name),
        })
    }

    /// Clips of a model, rendered into 8 bits one after the other.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for cameras without a clip; those of [`Self::frames`] and of `each`.
    pub(super) fn model(
        &mut self,
        name: &str,
        model: &Model,
        cameras: &CameraSet,
        guesses: &[UndoGuess],
        each: &mut dyn FnMut(SeenClip) -> Result<(), EngineError>,
    ) -> Result<(), EngineError> {
        let clips = cameras.clips();
        if clips.is_empty() {
            return Err(no_frame(name));
        }
        let mut renderer = SceneRenderer::new(self.device, &model.gaussians, &model.motion, model.background)?;
        for (number, clip) in clips.iter().enumerate() {
            let mut frames = Vec::with_capacity(clip.len());
            renderer.render_clips(std::slice::from_ref(clip), |_, camera, pixels| {
                frames.push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
                Ok(())
            })?;
            each(self.frames(&format!("{name}, view {number}"), &frames, guesses)?)?;
        }
        Ok(())
    }
}

fn no_frame(name: &str) -> EngineError {
    EngineError::Usage { what: name.to_owned(), got: "no frame".to_owned(), expected: "at least one".to_owned() }
}
