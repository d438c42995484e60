//! What draws the original as a film shows it: by the film's renderer, as finely, on its background.

use guard4d_kernels::Device;

use super::drawing::{Drawn, Look, Painter};
use super::residual::{background, counted, difference};
use super::shot::Shot;
use crate::error::EngineError;
use crate::render::making::Making;
use crate::render::profile::Viewer;
use crate::render::settings::Settings;
use crate::scene::Model;

/// How much less a film has to differ from one renderer's picture to be taken for its, of that of the likelier one.
const CLEARLY: f64 = 0.98;
/// Least share of a frame that has to count, for the frame to tell how its film was drawn: a part of an asset that
/// comes into view looks as if it were drawn by anybody.
const TELLING: f64 = 0.02;

/// The original in a shot.
#[derive(Debug)]
pub(super) struct Taken {
    /// What draws it again.
    pub drawn: Drawn,
    /// `[H, W, 4]`; the last channel is the final transmittance.
    pub clean: Vec<f32>,
}

/// Everybody who draws the original.
#[derive(Debug)]
pub(super) struct Studio {
    device: Device,
    painters: Vec<Painter>,
    /// At which settings frames were taken, whose pictures are asked for again.
    taken: Vec<Settings>,
}

impl Studio {
    pub(super) fn new(device: &Device) -> Self {
        Self { device: device.clone(), painters: Vec::new(), taken: Vec::new() }
    }

    /// The original in a shot of a film, drawn as `known` says or, where nothing is known yet, as the shot tells.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for a camera of another size than its frame; when memory runs out or the device fails.
    pub(super) fn take_of_film(
        &mut self,
        model: &Model,
        shot: &Shot<'_>,
        known: &mut Option<Look>,
    ) -> Result<Taken, EngineError> {
        if known.is_none() {
            *known = self.look_of(model, shot)?;
        }
        self.take(model, shot, known.unwrap_or(Look::of(model)))
    }

    /// The original in a shot, drawn like that.
    ///
    /// # Errors
    /// As [`take_of_film`](Self::take_of_film).
    pub(super) fn take(&mut self, model: &Model, shot: &Shot<'_>, look: Look) -> Result<Taken, EngineError> {
        let taken = self.try_out(model, shot, look)?;
        let settings = look.making.settings;
        if !self.taken.contains(&settings) {
            self.taken.push(settings);
        }
        Ok(taken)
    }

    /// The same, for now.
    fn try_out(&mut self, model: &Model, shot: &Shot<'_>, look: Look) -> Result<Taken, EngineError> {
        check_size(shot)?;
        let settings = look.making.settings;
        if !self.painters.iter().any(|painter| painter.settings() == settings) {
            // Whoever has the splats, and is not asked again, draws at these settings instead.
            let is_free = |painter: &Painter| {
                painter.settings().keeps_splats_of(&settings) && !self.taken.contains(&painter.settings())
            };
            let painter = match self.painters.iter().position(is_free) {
                Some(at) => self.painters.swap_remove(at).at(settings),
                None => Painter::new(&self.device, model, settings)?,
            };
            self.painters.push(painter);
        }
        let painter = self.painter(settings);
        let drawn = painter.plan(&shot.camera, shot.time, look)?;
        let clean = painter.draw(&drawn)?;
        Ok(Taken { drawn, clean })
    }

    /// Who draws at these settings.
    ///
    /// # Panics
    /// Unless a shot was taken so.
    pub(super) fn painter(&mut self, settings: Settings) -> &mut Painter {
        let painter = self.painters.iter_mut().find(|painter| painter.settings() == settings);
        painter.expect("whoever drew a frame is kept")
    }

    /// How a film was drawn that this is a frame of: as it is least different from the unmarked asset. None where too
    /// little of that is in the frame.
    fn look_of(&mut self, model: &Model, shot: &Shot<'_>) -> Result<Option<Look>, EngineError> {
        let own = Look::of(model);
        let Taken { clean, .. } = self.try_out(model, shot, own)?;
        let counted = counted(shot.frame, &clean);
        if (counted.iter().filter(|counted| **counted).count() as f64) < TELLING * counted.len() as f64 {
            return Ok(None);
        }
        // The model's own background, unless the film plainly shows another colour.
        let look = Look { background: background(shot.frame, &clean, own.background).unwrap_or(own.background), ..own };
        let (mut best, mut least) = (look.making, f64::INFINITY);
        for viewer in Viewer::ALL {
            for times in Making::TIMES {
                let making = Making { settings: viewer.into(), times };
                let squares = self.squares(model, shot, Look { making, ..look })?;
                if squares < CLEARLY * least {
                    (best, least) = (making, squares);
                }
            }
            self.keep(&[own.making.settings, best.settings]);
        }
        let settings = best.settings.fitted(model.gaussians.sh_degree, CLEARLY, least, &mut |settings| {
            let squares = self.squares(model, shot, Look { making: Making { settings, ..best }, ..look })?;
            self.keep(&[own.making.settings, best.settings]);
            Ok::<_, EngineError>(squares)
        })?;
        self.keep(&[own.making.settings, settings]);
        Ok(Some(Look { making: Making { settings, ..best }, ..look }))
    }

    /// How much a frame differs from the unmarked asset, drawn like that.
    fn squares(&mut self, model: &Model, shot: &Shot<'_>, look: Look) -> Result<f64, EngineError> {
        let Taken { clean, .. } = self.try_out(model, shot, look)?;
        Ok(difference(shot.frame, &clean).limited.iter().map(|r| f64::from(*r).powi(2)).sum())
    }

    /// Keeps who draws at these settings, and whoever took frames.
    fn keep(&mut self, settings: &[Settings]) {
        self.painters
            .retain(|painter| [settings, &self.taken[..]].iter().any(|kept| kept.contains(&painter.settings())));
    }
}

fn check_size(shot: &Shot<'_>) -> Result<(), EngineError> {
    let (frame, camera) = (shot.frame, &shot.camera);
    if [frame.width(), frame.height()] == [camera.width, camera.height] {
        return Ok(());
    }
    Err(EngineError::Usage {
        what: "camera of a frame".to_owned(),
        got: format!("{}x{} pixels", camera.width, camera.height),
        expected: format!("{}x{}, as the frame has", frame.width(), frame.height()),
    })
}
