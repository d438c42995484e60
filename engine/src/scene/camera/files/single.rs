//! A file with one camera, as `guard4d dump` takes it.

use glam::DMat3;
use serde::Deserialize;

use super::reader::Reader;
use crate::base::files::bad_data;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::camera::cameras::{Camera, CameraSet, View};

/// World-to-camera matrix with OpenCV axes.
#[derive(Deserialize)]
struct SingleCamera {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    world_to_camera_row_major: [[f64; 4]; 4],
    time: Option<f64>,
}

/// Reads the file's object.
pub(super) fn read(reader: Reader<'_>, value: serde_json::Value) -> Result<CameraSet, EngineError> {
    let file: SingleCamera = reader.parse_as(value)?;
    let field = "world_to_camera_row_major";
    let matrix = reader.affine(field, &file.world_to_camera_row_major)?;
    // Inverted, so that one function checks all poses; what it makes of it is rounded more often than the file's
    // matrix.
    let rotation = DMat3::from_mat4(matrix).transpose();
    let position = -(rotation * matrix.w_axis.truncate());
    reader.rigid(field, rotation, position)?;
    let size = reader.size("", file.width.into(), file.height.into())?;
    let lens = reader.lens("", size, [file.fx, file.fy], [None; 2])?;
    if let Some(time) = file.time.filter(|time| !(0.0..=1.0).contains(time)) {
        return Err(bad_data(reader.path, "time", time, "0 to 1"));
    }
    reader.set(vec![View {
        name: "camera".to_owned(),
        camera: Camera { world_to_camera: matrix.as_mat4(), ..lens },
        times: file.time.map(narrow).into_iter().collect(),
        located: true,
    }])
}
