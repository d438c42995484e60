//! What is suspected of carrying a mark: films as they are, and models, of which films are made.

use std::path::{Path, PathBuf};

use guard4d_engine::detect::suspect::Suspect;
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::Model;
use guard4d_engine::scene::recognise::is_model;

use super::model;
use super::views::cameras;
use crate::flags::common::Common;
use crate::flags::views::EvaluationViews;

/// Takes films and folders of frames as they are, and has models filmed from `views`.
///
/// With the unmarked model at hand others are filmed as it is: a moment of it alone would be filmed from elsewhere, and
/// files of splats do not say what is behind them.
pub(crate) fn open(
    paths: &[PathBuf],
    views: &EvaluationViews,
    original: Option<&Model>,
    common: &Common,
) -> Result<Vec<Suspect>, EngineError> {
    let suspect = |path: &PathBuf| match is_model(path)? {
        true => filmed(path, views, original, common),
        false => Ok(Suspect::Video(path.clone())),
    };
    paths.iter().map(suspect).collect()
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
