//! The original as a film would show it: from the film's camera, drawn as the film was, in its levels. What cannot be
//! compared, and what a mark cannot be, is the film's own.

use guard4d_kernels::Device;

use super::drawing::Look;
use super::residual::as_shown;
use super::shot::Shot;
use super::studio::{Studio, Taken};
use crate::error::EngineError;
use crate::media::Frame;
use crate::scene::Model;

/// Films the original again, frame by frame of one film.
#[derive(Debug)]
pub struct AsFilmed<'a> {
    model: &'a Model,
    studio: Studio,
    look: Option<Look>,
}

impl<'a> AsFilmed<'a> {
    /// Of an unmarked asset.
    #[must_use]
    pub fn new(device: &Device, model: &'a Model) -> Self {
        Self { model, studio: Studio::new(device), look: None }
    }

    /// What comes next is of another film.
    pub fn next_film(&mut self) {
        self.look = None;
    }

    /// The frame of a shot as it would be, were it the original's.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a camera of another size than its frame; when memory runs out or the device fails.
    pub fn picture(&mut self, shot: &Shot<'_>) -> Result<Frame, EngineError> {
        let Taken { clean, .. } = self.studio.take_of_film(self.model, shot, &mut self.look)?;
        Frame::new(shot.frame.width(), shot.frame.height(), as_shown(shot.frame, &clean))
    }
}
