//! What a mark is worth in films of each class of cameras.

use std::collections::BTreeMap;

use super::evaluate::{ClassFigure, mean_accuracy, p_values, read_clips, share_proving};
use crate::error::EngineError;
use crate::evidence::message::Message;
use crate::evidence::reading::Reading;
use crate::media::Frame;
use crate::render::SceneRenderer;
use crate::scene::camera::classes::CameraClass;
use crate::scene::camera::look_at::LookAt;
use crate::scene::camera::paths::Lens;
use crate::scene::{Camera, Gaussians};
use crate::watermark::embed::Subject;
use crate::watermark::extractor::reader::Reader;
use crate::watermark::extractor::weights::ExtractorWeights;

/// Frames of a film.
const FRAMES: u32 = 8;

/// Films of classes: what is filmed, and how often.
#[derive(Clone, Copy, Debug)]
pub struct ClassFilms {
    /// Where training looks from.
    pub look_at: LookAt,
    /// Through which lens.
    pub lens: Lens,
    /// Films of each class; with none nothing is measured.
    pub films: u32,
    /// Largest p-value of a film that proves the message alone.
    pub fpr: f64,
}

impl ClassFilms {
    /// Films the marked asset in 8 bits by cameras of every class, and reads each film as `verify` does.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a lens that is none; when the device fails.
    pub fn measure(
        &self,
        subject: Subject<'_>,
        marked_sh: &[f32],
        extractor: &ExtractorWeights,
    ) -> Result<BTreeMap<CameraClass, ClassFigure>, EngineError> {
        let mut figures = BTreeMap::new();
        if self.films == 0 {
            return Ok(figures);
        }
        let Subject { device, clip, key, model, message } = subject;
        let gaussians = Gaussians { sh_coeffs: marked_sh.to_vec(), ..model.gaussians.clone() };
        let mut renderer = SceneRenderer::new(device, &gaussians, &model.motion, model.background)?;
        let mut reader = Reader::new(device, clip, key, extractor)?;
        for class in CameraClass::ALL {
            let mut films = vec![Vec::new(); self.films as usize];
            renderer.render_clips(&self.shots(class)?, |film, camera, pixels| {
                films[film].push(Frame::from_rgba32f(camera.width, camera.height, pixels)?);
                Ok(())
            })?;
            let readings = read_clips(&mut reader, &films, key.bits())?;
            figures.insert(class, self.figure(&readings, message, extractor)?);
        }
        Ok(figures)
    }

    /// Each film goes around the asset once, while time runs from start to end.
    fn shots(&self, class: CameraClass) -> Result<Vec<Vec<(Camera, f32)>>, EngineError> {
        let around = class.cameras(self.look_at, self.lens, self.films * FRAMES)?.views;
        let films = self.films as usize;
        let film = |number: usize| {
            let views = around.iter().skip(number).step_by(films).enumerate();
            views.map(|(frame, view)| (view.camera, (frame as f32 + 0.5) / FRAMES as f32)).collect()
        };
        Ok((0..films).map(film).collect())
    }

    fn figure(
        &self,
        readings: &[Reading],
        message: &Message,
        extractor: &ExtractorWeights,
    ) -> Result<ClassFigure, EngineError> {
        Ok(ClassFigure {
            films: self.films,
            frames: FRAMES,
            bit_accuracy: mean_accuracy(readings, message)?,
            proven: share_proving(&p_values(readings, message, extractor.key_rotation)?, self.fpr),
        })
    }
}
