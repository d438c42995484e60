//! The message where film and original are compared, frame by frame: each is cut to the frame of training where that
//! lies in it, and what the extractor reads of the original there is taken off what it reads of the film.
//!
//! What is left is the mark's, not the scene's. No key takes part in what is shown to the extractor.

use guard4d_kernels::Device;
use guard4d_kernels::image::resize::ImageSize;

use crate::error::EngineError;
use crate::fingerprint::as_filmed::AsFilmed;
use crate::fingerprint::shot::Shot;
use crate::media::Frame;
use crate::picture::known_cameras::KnownCameras;
use crate::picture::part::Part;
use crate::picture::undo_guess::UndoGuess;
use crate::scene::camera::paths::Lens;
use crate::scene::{Camera, LookAt, Model};
use crate::watermark::embed::TrainingViews;
use crate::watermark::extractor::reader::Reader;
use crate::watermark::extractor::weights::CLIP_FRAMES;

/// Films against the original, one after the other.
#[derive(Debug)]
pub struct Comparer<'a> {
    as_filmed: AsFilmed<'a>,
    look_at: LookAt,
    lens: Lens,
    films: Vec<Frame>,
    originals: Vec<Frame>,
    cameras: Vec<Camera>,
    logits: Vec<f32>,
}

impl<'a> Comparer<'a> {
    /// Of an unmarked asset, and how training looked at it.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for training frames of a size that no image has.
    pub fn new(device: &Device, original: &'a Model, views: &TrainingViews) -> Result<Self, EngineError> {
        Ok(Self {
            as_filmed: AsFilmed::new(device, original),
            look_at: views.look_at(original),
            lens: views.lens()?,
            films: Vec::new(),
            originals: Vec::new(),
            cameras: Vec::new(),
            logits: Vec::new(),
        })
    }

    /// Takes the next frame of a film.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a camera of another size than its frame; when memory runs out or the device fails.
    pub fn push(&mut self, reader: &mut Reader, shot: &Shot<'_>) -> Result<(), EngineError> {
        self.originals.push(self.as_filmed.picture(shot)?);
        self.films.push(shot.frame.clone());
        self.cameras.push(shot.camera);
        if self.films.len() == CLIP_FRAMES { self.read(reader) } else { Ok(()) }
    }

    /// Ends a film.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    pub fn next_film(&mut self, reader: &mut Reader) -> Result<(), EngineError> {
        self.as_filmed.next_film();
        self.read(reader)
    }

    /// Logits of all frames `[n, L]`, less the original's.
    #[must_use]
    pub fn into_logits(self) -> Vec<f32> {
        self.logits
    }

    fn read(&mut self, reader: &mut Reader) -> Result<(), EngineError> {
        let Some(first) = self.films.first() else { return Ok(()) };
        let size = ImageSize { height: first.height() as usize, width: first.width() as usize };
        let cameras = std::mem::take(&mut self.cameras);
        let frames = cameras.len();
        let parts = KnownCameras { cameras, look_at: self.look_at, lens: self.lens }.parts(frames, size)?;
        let film = logits(reader, &mut self.films, &parts)?;
        let original = logits(reader, &mut self.originals, &parts)?;
        self.logits.extend(film.iter().zip(original).map(|(film, original)| film - original));
        Ok(())
    }
}

/// Logits of a clip, of which these parts are shown.
fn logits(reader: &mut Reader, frames: &mut Vec<Frame>, parts: &[Part]) -> Result<Vec<f32>, EngineError> {
    let mut stream = reader.stream(&[UndoGuess::NONE], parts.to_vec());
    frames.drain(..).try_for_each(|frame| stream.push(frame))?;
    Ok(stream.finish()?.into_iter().next().unwrap_or_default().logits)
}
