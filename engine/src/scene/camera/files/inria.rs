//! INRIA's `cameras.json`, which 3D Gaussian splatting writes beside its models.

use glam::{DMat3, DVec3};
use serde::Deserialize;

use super::reader::Reader;
use crate::error::EngineError;
use crate::scene::camera::cameras::{Camera, CameraSet, View};

/// One entry; camera-to-world rotation with OpenCV axes. The principal point is not kept: it is the middle.
#[derive(Deserialize)]
struct InriaCamera {
    img_name: String,
    width: u32,
    height: u32,
    position: [f64; 3],
    rotation: [[f64; 3]; 3],
    fx: f64,
    fy: f64,
}

/// Reads the file's array.
pub(super) fn read(reader: Reader<'_>, value: serde_json::Value) -> Result<CameraSet, EngineError> {
    let cameras: Vec<InriaCamera> = reader.parse_as(value)?;
    let views = cameras.into_iter().enumerate().map(|(number, camera)| {
        let of = format!("[{number}].");
        let rotation = DMat3::from_cols_array_2d(&camera.rotation).transpose();
        let position = DVec3::from_array(camera.position);
        let world_to_camera = reader.rigid(format!("{of}rotation"), rotation, position)?;
        let size = reader.size(&of, camera.width.into(), camera.height.into())?;
        let lens = reader.lens(&of, size, [camera.fx, camera.fy], [None; 2])?;
        Ok(View { name: camera.img_name, camera: Camera { world_to_camera, ..lens }, times: Vec::new(), located: true })
    });
    reader.set(views.collect::<Result<_, EngineError>>()?)
}
