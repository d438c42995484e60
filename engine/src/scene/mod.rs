//! Scenes: Gaussians, their deformation, cameras, and the files that hold them.

use std::fmt::Display;
use std::path::Path;

use crate::error::EngineError;

pub mod axes;
pub mod camera;
pub mod camera_files;
pub mod camera_flight;
pub mod camera_paths;
pub mod cfg_args;
pub mod deformation;
mod folder;
pub mod formats;
pub mod gaussians;
pub mod limits;
mod literal;
pub mod model;
pub mod motion;
pub mod ply;
pub mod procedural;
pub mod pth;
mod sequence;
pub mod source;
pub mod trajectories;
pub mod vantage;
pub mod warp;

pub use camera::{Camera, CameraSet, ImageSize, View};
pub use cfg_args::DeformConfig;
pub use deformation::DeformationWeights;
pub use gaussians::Gaussians;
pub use model::Model;
pub use motion::Motion;
pub use ply::PlyFile;
pub use source::SplatSource;
pub use vantage::Vantage;

/// A [`EngineError::BadData`] about `field` of the file at `path`.
pub(crate) fn bad_data(path: &Path, field: impl Display, got: impl Display, expected: impl Display) -> EngineError {
    EngineError::BadData {
        path: path.to_path_buf(),
        field: field.to_string(),
        got: got.to_string(),
        expected: expected.to_string(),
    }
}

/// Reads a whole regular file; `expected` says what should have been there.
///
/// # Errors
/// [`EngineError::MissingInput`] if nothing is there, [`EngineError::BadData`] for a folder, pipe or
/// device, [`EngineError::Io`] if reading fails.
pub(crate) fn read_file(path: &Path, expected: &str) -> Result<Vec<u8>, EngineError> {
    let io_error = |source: std::io::Error| match source.kind() {
        std::io::ErrorKind::NotFound => {
            EngineError::MissingInput { path: path.to_path_buf(), expected: expected.to_owned() }
        }
        _ => EngineError::Io { path: path.to_path_buf(), source },
    };
    if !std::fs::metadata(path).map_err(io_error)?.is_file() {
        return Err(bad_data(path, "file type", "not a regular file", expected));
    }
    std::fs::read(path).map_err(io_error)
}

#[allow(
    clippy::cast_possible_truncation,
    reason = "the engine computes in f32; a double out of range becomes infinite, which every reader refuses"
)]
pub(crate) fn narrow(value: f64) -> f32 {
    value as f32
}
