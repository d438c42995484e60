//! What is suspected of carrying a mark: films as they are, and models, of which films are made.

use std::path::{Path, PathBuf};

use guard4d_engine::detect::suspect::{FilmedSuspect, Suspect};
use guard4d_engine::error::EngineError;
use guard4d_engine::media::{FrameSource, ReadOptions};
use guard4d_engine::picture::known_cameras::KnownCameras;
use guard4d_engine::scene::Model;
use guard4d_engine::scene::recognise::is_model;
use guard4d_engine::watermark::embed::TrainingViews;

use super::model;
use super::views::cameras;
use crate::flags::common::Common;
use crate::flags::views::EvaluationViews;

/// Takes films and folders of frames as they are, and has models filmed from `views`. Where it is given how a mark was
/// trained, films are those of `views` too.
///
/// With the unmarked model at hand others are filmed as it is: a moment of it alone would be filmed from elsewhere, and
/// files of splats do not say what is behind them.
pub(crate) fn open(
    paths: &[PathBuf],
    views: &EvaluationViews,
    original: Option<&Model>,
    trained: Option<&TrainingViews>,
    common: &Common,
) -> Result<Vec<Suspect>, EngineError> {
    let known = match (original, trained) {
        (Some(original), Some(trained)) => Some(known_cameras(views, original, trained)?),
        _ => None,
    };
    let suspect = |path: &PathBuf| match (is_model(path)?, &known) {
        (true, _) => filmed(path, views, original, common),
        (false, Some(cameras)) => Ok(Suspect::Filmed { path: path.clone(), cameras: cameras.clone() }),
        (false, None) => Ok(Suspect::Video(path.clone())),
    };
    paths.iter().map(suspect).collect()
}

/// Films that the cameras of --cameras took: those with as many frames as there are cameras and moments.
pub(crate) fn filmed_by(
    paths: &[PathBuf],
    views: &EvaluationViews,
    original: &Model,
    options: &ReadOptions,
) -> Result<Vec<FilmedSuspect>, EngineError> {
    if views.cameras.is_none() {
        return Ok(Vec::new());
    }
    let cameras = cameras(views, original)?;
    let moments: u64 = cameras.clips().iter().map(|clip| clip.len() as u64).sum();
    let mut filmed = Vec::new();
    for path in paths {
        if !is_model(path)? && FrameSource::open(path, options)?.expected_frames() == Some(moments) {
            filmed.push(FilmedSuspect { path: path.clone(), cameras: cameras.clone() });
        }
    }
    Ok(filmed)
}

/// Those that are films, not models.
pub(crate) fn films(paths: &[PathBuf]) -> Result<Vec<PathBuf>, EngineError> {
    let mut films = Vec::new();
    for path in paths {
        if !is_model(path)? {
            films.push(path.clone());
        }
    }
    Ok(films)
}

/// The cameras that took a film, view by view.
fn known_cameras(
    views: &EvaluationViews,
    original: &Model,
    trained: &TrainingViews,
) -> Result<KnownCameras, EngineError> {
    let cameras = cameras(views, original)?.clips().concat().into_iter().map(|(camera, _)| camera).collect();
    Ok(KnownCameras { cameras, look_at: trained.look_at(original), lens: trained.lens()? })
}

fn filmed(
    path: &Path,
    views: &EvaluationViews,
    original: Option<&Model>,
    common: &Common,
) -> Result<Suspect, EngineError> {
    let mut model = model::open(path, common)?;
    let cameras = cameras(views, original.unwrap_or(&model))?;
    if let Some(original) = original {
        model.background = original.background;
    }
    Ok(Suspect::Model { name: path.display().to_string(), model: Box::new(model), cameras })
}
