//! `guard4d render`

use std::path::PathBuf;

use clap::Args;
use guard4d_engine::base::output::AtomicFile;
use guard4d_engine::error::EngineError;
use guard4d_engine::media::Frame;
use guard4d_engine::render::SceneRenderer;
use guard4d_engine::render::profile::Viewer;
use guard4d_engine::render::settings::Settings;

use crate::flags::common::Common;
use crate::flags::film::FilmArgs;
use crate::flags::views::EvaluationViews;
use crate::shared::farm_job::{FarmJob, keep_in_records, out_and_input};
use crate::shared::views::cameras;
use crate::shared::{device, film, model};
use crate::ui::outcome::Outcome;
use crate::ui::progress::bar;
use crate::ui::stop;

/// Splats that are widened by more, px², are not recognised.
const MOST_DILATION: f32 = 100.0;

/// What is filmed, from where, and what with.
#[derive(Args, Debug)]
pub(crate) struct RenderArgs {
    /// Model, as `inspect` can read it: a folder, or a file of splats
    model: PathBuf,
    /// Renderer whose pictures are wanted: reference, gsplat, gsplat-antialiased, spark, playcanvas,
    /// gaussian-splats-3d, supersplat or antimatter15
    ///
    /// Viewers differ in how they widen, cut, bend, sort and round splats; each is drawn as it is at its own settings.
    /// Backgrounds stay the model's.
    #[arg(long = "as", value_name = "NAME", default_value = "reference", hide_default_value = true)]
    viewer: Viewer,
    /// What the renderer adds to both variances of a splat on the image, where that is not what it usually adds
    ///
    /// 0.3 is usual. `trace` and `locate` tell what fits a film.
    #[arg(long, value_name = "PX2", value_parser = dilation)]
    dilation: Option<f32>,
    /// Draw spherical harmonics up to this degree alone, from 0 to 3
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=3))]
    sh_degree: Option<u32>,
    #[command(flatten)]
    views: EvaluationViews,
    #[command(flatten)]
    film: FilmArgs,
    /// Also write the camera and time of each frame, in the film's order, as transforms JSON
    ///
    /// `render --cameras` films the same again, and `trace --cameras` needs it.
    #[arg(long, value_name = "FILE", help_heading = "Film")]
    save_cameras: Option<PathBuf>,
}

pub(crate) const FARM: FarmJob = FarmJob {
    command: "render",
    has_input: true,
    needs_device: true,
    arguments: out_and_input,
    reserved: &["out", "overwrite"],
    keep: keep_in_records,
    trial: None,
};

pub(crate) fn run(args: &RenderArgs, common: &Common) -> Result<Outcome, EngineError> {
    stop::listen(common);
    let device = device::open(common)?;
    let model = model::open(&args.model, common)?;
    let cameras = cameras(&args.views, &model)?;
    let size = cameras.views.first().map_or(args.views.size(), |view| (view.camera.width, view.camera.height));
    let clips = cameras.clips();
    let total: usize = clips.iter().map(Vec::len).sum();
    let progress = bar(common, total as u64);
    let settings = Settings { viewer: args.viewer, dilation: args.dilation, sh_degree: args.sh_degree };
    let (profile, background) = (settings.profile(), model.background);
    let mut renderer = SceneRenderer::by_profile(&device, &model.gaussians, &model.motion, background, &profile)?;
    let shoot = |each: &mut dyn FnMut(Frame) -> Result<(), EngineError>| {
        renderer.render_clips(&clips, |_, camera, pixels| {
            stop::check()?;
            progress.inc(1);
            each(Frame::from_rgba32f(camera.width, camera.height, pixels)?)
        })
    };
    // Created before frames are drawn, which take long, and put in its place behind them.
    let existing = args.film.overwrite.existing();
    let file = args.save_cameras.as_ref().map(|path| AtomicFile::create(path, existing)).transpose()?;
    film::write(&args.film, size, shoot)?;
    if let Some(file) = file {
        file.finish(&cameras.film_json())?;
    }
    progress.finish_and_clear();
    Ok(Outcome::Done)
}

/// Reads `--dilation`.
fn dilation(text: &str) -> Result<f32, String> {
    let dilation = text.parse().ok().filter(|dilation| (0.0..=MOST_DILATION).contains(dilation));
    dilation.ok_or_else(|| format!("a number from 0 to {MOST_DILATION} is expected"))
}
