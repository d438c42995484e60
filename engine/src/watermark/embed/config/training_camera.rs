//! A camera of a capture, as settings keep it.

use glam::{Mat4, Vec4};
use serde::{Deserialize, Serialize};

use super::parse::check;
use crate::error::EngineError;
use crate::scene::{Camera, FrameSize};

/// Largest distance of a rotation's product with its transpose from the identity.
const RIGID: f32 = 1e-3;

/// A camera of a capture. Settings hold the numbers themselves, so that an extractor can be fitted again by whoever has
/// a receipt and the asset, without the files of the capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingCamera {
    /// From world to camera space, OpenCV axes: three rows of a rotation and a shift.
    world_to_camera: [[f32; 4]; 3],
    /// Focal lengths, then the principal point, px.
    lens_px: [f32; 4],
    /// Width and height, px.
    size_px: (u32, u32),
}

impl TrainingCamera {
    /// Keeps a camera.
    #[must_use]
    pub fn of(camera: &Camera) -> Self {
        let rows = camera.world_to_camera.transpose();
        Self {
            world_to_camera: [rows.x_axis, rows.y_axis, rows.z_axis].map(|row| row.to_array()),
            lens_px: [camera.fx, camera.fy, camera.cx, camera.cy],
            size_px: (camera.width, camera.height),
        }
    }

    /// The camera.
    #[must_use]
    pub fn camera(&self) -> Camera {
        let [x, y, z] = self.world_to_camera.map(Vec4::from_array);
        let [fx, fy, cx, cy] = self.lens_px;
        let (width, height) = self.size_px;
        Camera { world_to_camera: Mat4::from_cols(x, y, z, Vec4::W).transpose(), fx, fy, cx, cy, width, height }
    }

    pub(super) fn validate(&self) -> Result<(), EngineError> {
        let [fx, fy, ..] = self.lens_px;
        let is_lens = self.lens_px.iter().all(|v| v.is_finite()) && fx > 0.0 && fy > 0.0;
        check("lens_px of a camera", format!("{:?}", self.lens_px), is_lens, "positive focal lengths and a point")?;
        FrameSize::new(self.size_px.0, self.size_px.1)?;
        let pose = self.camera().world_to_camera;
        let rotation = glam::Mat3::from_mat4(pose);
        let is_rigid = pose.is_finite()
            && (rotation * rotation.transpose()).abs_diff_eq(glam::Mat3::IDENTITY, RIGID)
            && rotation.determinant() > 0.0;
        let got = format!("{:?}", self.world_to_camera);
        check("world_to_camera of a camera", got, is_rigid, "a rotation and a shift, row by row")
    }
}
