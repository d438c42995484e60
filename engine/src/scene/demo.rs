//! The scene that ships inside the program.

use std::path::Path;

use tempfile::TempDir;

use crate::error::EngineError;
use crate::scene::camera::{CameraSet, FrameSize};

const ITERATION: &str = "point_cloud/iteration_20000";

/// The embedded scene, unpacked for as long as this value lives.
#[derive(Debug)]
pub struct DemoScene {
    folder: TempDir,
}

/// (path, bytes) of every file of the scene.
macro_rules! files {
    ($($path:literal),*) => {
        [$(($path, include_bytes!(concat!("../../assets/demo-scene/", $path)).as_slice())),*]
    };
}

impl DemoScene {
    /// Writes the scene to a temporary folder.
    ///
    /// # Errors
    /// [`EngineError::Io`] when it cannot be written.
    pub fn unpack() -> Result<Self, EngineError> {
        let folder = tempfile::tempdir().map_err(|source| EngineError::Io { path: std::env::temp_dir(), source })?;
        let put = |path: &str, bytes: &[u8]| {
            let path = folder.path().join(path);
            std::fs::write(&path, bytes).map_err(|source| EngineError::Io { path, source })
        };
        let iteration = folder.path().join(ITERATION);
        std::fs::create_dir_all(&iteration).map_err(|source| EngineError::Io { path: iteration, source })?;
        for (path, bytes) in files![
            "cfg_args",
            "transforms_test.json",
            "point_cloud/iteration_20000/point_cloud.ply",
            "point_cloud/iteration_20000/deformation.pth",
            "point_cloud/iteration_20000/deformation_table.pth",
            "point_cloud/iteration_20000/deformation_accum.pth"
        ] {
            put(path, bytes)?;
        }
        Ok(Self { folder })
    }

    /// The model folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Cameras of the scene's test clips.
    ///
    /// # Errors
    /// [`EngineError::Usage`] for an impossible size.
    pub fn cameras(&self, size_px: (u32, u32)) -> Result<CameraSet, EngineError> {
        CameraSet::open(&self.path().join("transforms_test.json"), FrameSize::new(size_px.0, size_px.1)?)
    }
}
