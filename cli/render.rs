//! `guard4d render`

use guard4d_engine::EngineError;
use guard4d_engine::media::Frame;
use guard4d_engine::render::Film;

use crate::args::{Common, RenderArgs};
use crate::film;
use crate::progress::bar;
use crate::report::Outcome;
use crate::stop;
use crate::views::cameras;
use crate::{devices, model};

pub(crate) fn run(args: &RenderArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    let device = devices::open(common)?;
    let model = model::open(&args.model, common)?;
    let cameras = cameras(&args.views, &model)?;
    let size = cameras.views.first().map_or(args.views.size(), |view| (view.camera.width, view.camera.height));
    let clips = cameras.clips();
    let total: usize = clips.iter().map(Vec::len).sum();
    let progress = bar(common, total as u64);
    let mut film = Film::new(&device, &model.gaussians, &model.motion, model.background)?;
    let shoot = |each: &mut dyn FnMut(Frame) -> Result<(), EngineError>| {
        film.shoot(&clips, |_, camera, pixels| {
            stop::check()?;
            progress.inc(1);
            each(Frame::from_rgba32f(camera.width, camera.height, pixels)?)
        })
    };
    film::write(&args.film, size, shoot)?;
    progress.finish_and_clear();
    Ok(Outcome::Done)
}
