//! nerfstudio's `camera_path.json`, which its viewer writes and `ns-render camera-path` renders.

use serde::Deserialize;

use super::reader::Reader;
use crate::base::files::bad_data;
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::camera::cameras::{Camera, CameraSet, View};

/// The only camera type that is a pinhole; nerfstudio takes it when none is named.
const PERSPECTIVE: &str = "perspective";

#[derive(Deserialize)]
struct PathFile {
    camera_type: Option<String>,
    render_width: Option<u32>,
    render_height: Option<u32>,
    camera_path: Vec<Stop>,
}

/// One frame of the clip. Its `aspect` repeats the image size and is not read, as nerfstudio does not.
#[derive(Deserialize)]
struct Stop {
    /// Row-major, OpenGL axes.
    camera_to_world: [f64; 16],
    /// Vertical field of view, degrees.
    fov: f64,
    render_time: Option<f64>,
}

/// Reads the file's object. Where it does not tell the time, the clip lasts from 0 to 1.
pub(super) fn read(reader: Reader<'_>, value: serde_json::Value) -> Result<CameraSet, EngineError> {
    let file: PathFile = reader.parse_as(value)?;
    if let Some(kind) = file.camera_type.filter(|kind| kind != PERSPECTIVE) {
        return Err(bad_data(reader.path, "camera_type", kind, PERSPECTIVE));
    }
    let width = file.render_width.unwrap_or(reader.size.width());
    let height = file.render_height.unwrap_or(reader.size.height());
    let size = reader.size("render ", width.into(), height.into())?;
    let times: Vec<Option<f64>> = file.camera_path.iter().map(|stop| stop.render_time).collect();
    let times = reader.times(&times, |number| format!("camera_path[{number}].render_time"), 1.0)?;
    let last = times.len().saturating_sub(1).max(1) as f64;
    let mut views = Vec::new();
    for (number, (stop, time)) in file.camera_path.iter().zip(times).enumerate() {
        let of = format!("camera_path[{number}].");
        let rows: &[[f64; 4]; 4] =
            &std::array::from_fn(|row| std::array::from_fn(|c| stop.camera_to_world[4 * row + c]));
        let world_to_camera = reader.opengl_pose(format!("{of}camera_to_world"), rows)?;
        if !(stop.fov > 0.0 && stop.fov < 180.0) {
            return Err(bad_data(reader.path, format!("{of}fov"), stop.fov, "an angle between 0 and 180 degrees"));
        }
        let focal = f64::from(height) / (2.0 * (stop.fov.to_radians() / 2.0).tan());
        let lens = reader.lens(&of, size, [focal; 2], [None; 2])?;
        let time = time.unwrap_or(narrow(number as f64 / last));
        let camera = Camera { world_to_camera, ..lens };
        views.push(View { name: format!("path_{number:05}"), camera, times: vec![time], located: true });
    }
    Ok(CameraSet { in_sequence: true, ..reader.set(views)? })
}
