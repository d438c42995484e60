//! `transforms*.json` of Blender, D-NeRF, instant-ngp and nerfstudio.

use std::path::Path;

use glam::{DMat3, DVec3};
use serde::Deserialize;
use serde_json::json;

use super::grouped::Grouped;
use super::reader::Reader;
use crate::base::files::{bad_data, read_file};
use crate::base::json::to_file;
use crate::error::EngineError;
use crate::scene::camera::cameras::{Camera, CameraSet, View};

/// Files of one D-NeRF dataset. Its times are divided by the largest of the first two, whichever file is read.
const DATASET: [&str; 3] = ["transforms_train.json", "transforms_test.json", "transforms_val.json"];

/// nerfstudio's camera models that are pinholes once their distortion is zero.
const PINHOLES: [&str; 5] = ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"];

/// Camera-to-world matrices with OpenGL axes.
#[derive(Deserialize)]
struct Transforms {
    #[serde(flatten)]
    lens: Lens,
    frames: Vec<Frame>,
    /// Ours: the frames are those of one film, in its order.
    #[serde(default)]
    in_sequence: bool,
}

/// What nerfstudio keeps for all frames or in each.
#[derive(Default, Deserialize, PartialEq)]
struct Lens {
    camera_angle_x: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    /// instant-ngp writes sides as 1920.0.
    w: Option<f64>,
    h: Option<f64>,
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: Option<String>,
    time: Option<f64>,
    /// Ours: the film shows the scene as in a mirror.
    #[serde(default)]
    mirrored: bool,
    /// Ours: whether this is known, see [`View::located`].
    #[serde(default = "yes")]
    located: bool,
    transform_matrix: [[f64; 4]; 4],
    #[serde(flatten)]
    lens: Lens,
}

fn yes() -> bool {
    true
}

/// The times of another file of the dataset; nothing else of it matters.
#[derive(Deserialize)]
struct Times {
    frames: Vec<Timed>,
}

#[derive(Deserialize)]
struct Timed {
    time: Option<f64>,
}

/// Largest time of the dataset's other files, if `path` is one of a dataset that has both a training and a test file.
pub(super) fn dataset_end(path: &Path) -> Result<Option<f64>, EngineError> {
    let [train, test, _] = DATASET.map(|name| path.with_file_name(name));
    let of_dataset = path.file_name().is_some_and(|name| DATASET.iter().any(|known| name == *known));
    if !(of_dataset && train.is_file() && test.is_file()) {
        return Ok(None);
    }
    let mut end: Option<f64> = None;
    for file in [train, test].iter().filter(|file| *file != path) {
        let expected = "frames with their times, as in the dataset's other files";
        let times: Times = crate::base::json::parse(file, "json", &read_file(file, "a camera file")?, expected)?;
        end = times.frames.into_iter().filter_map(|frame| frame.time).chain(end).reduce(f64::max);
    }
    Ok(end)
}

/// Reads the file's object; `dataset_end` is the largest time of the dataset's other files.
pub(super) fn read(
    reader: Reader<'_>,
    value: serde_json::Value,
    dataset_end: Option<f64>,
) -> Result<CameraSet, EngineError> {
    let file: Transforms = reader.parse_as(value)?;
    let times: Vec<Option<f64>> = file.frames.iter().map(|frame| frame.time).collect();
    // A file on its own is taken at its word up to 1: it may be a part of a dataset that ends later.
    let least = dataset_end.filter(|end| *end > 0.0).unwrap_or(1.0);
    let times = reader.times(&times, |number| format!("frames[{number}].time"), least)?;
    let mut grouped = Grouped::default();
    let mut film = Vec::new();
    for (number, (frame, time)) in file.frames.into_iter().zip(times).enumerate() {
        let of = format!("frames[{number}].");
        let lens = match frame.lens == Lens::default() {
            true => file.lens.camera(reader, "")?,
            false => frame.lens.or(&file.lens).camera(reader, &of)?,
        };
        let world_to_camera = reader.opengl_pose(format!("{of}transform_matrix"), &frame.transform_matrix)?;
        let name = frame.file_path.unwrap_or_else(|| format!("frame_{number:05}"));
        let camera = Camera { world_to_camera, ..lens };
        let camera = if frame.mirrored { camera.mirrored() } else { camera };
        if file.in_sequence {
            film.push(View { name, camera, times: time.into_iter().collect(), located: frame.located });
        } else {
            grouped.add(name, camera, time);
        }
    }
    let views = if file.in_sequence { film } else { grouped.views };
    Ok(CameraSet { in_sequence: file.in_sequence, ..reader.set(views)? })
}

impl CameraSet {
    /// The cameras and times of a film's frames as transforms JSON, which [`CameraSet::open`] reads back: the same
    /// pixels to some 1e-5 px, and the same times. Each frame has a lens of its own.
    #[must_use]
    pub fn film_json(&self) -> Vec<u8> {
        let shots = self.clips().concat();
        let known = self.film().into_iter().map(|shot| shot.is_some());
        let frames: Vec<_> = shots
            .iter()
            .zip(known)
            .enumerate()
            .map(|(number, ((camera, time), located))| frame_json(number, camera, *time, located))
            .collect();
        to_file(&json!({ "in_sequence": true, "frames": frames }))
    }
}

/// One frame of [`CameraSet::film_json`].
fn frame_json(number: usize, camera: &Camera, time: f32, located: bool) -> serde_json::Value {
    let mirrored = camera.is_mirrored();
    let camera = if mirrored { camera.mirrored() } else { *camera };
    let pose = camera.world_to_camera.as_dmat4();
    let turn = DMat3::from_mat4(pose).transpose();
    let position = -(turn * pose.w_axis.truncate());
    // OpenGL's y and z point the other way.
    let axes = turn * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let row = |i: usize| [axes.x_axis[i], axes.y_axis[i], axes.z_axis[i], position[i]];
    let [fx, fy, cx, cy] = [camera.fx, camera.fy, camera.cx, camera.cy].map(f64::from);
    let mut frame = json!({
        "file_path": format!("frame_{number:05}"),
        "time": time,
        "w": camera.width,
        "h": camera.height,
        "fl_x": fx,
        "fl_y": fy,
        // Such files count pixel edges, cameras count pixel centres.
        "cx": cx + 0.5,
        "cy": cy + 0.5,
        "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
    });
    if mirrored {
        frame["mirrored"] = true.into();
    }
    if !located {
        frame["located"] = false.into();
    }
    frame
}

impl Lens {
    /// A frame's own lens, with what it leaves out from the `shared` one.
    fn or(self, shared: &Self) -> Self {
        // Angle and focal lengths say the same thing, so they come from one place.
        let (camera_angle_x, fl_x, fl_y) = match self.fl_x.or(self.camera_angle_x) {
            Some(_) => (self.camera_angle_x, self.fl_x, self.fl_y),
            None => (shared.camera_angle_x, shared.fl_x, self.fl_y.or(shared.fl_y)),
        };
        Self {
            camera_angle_x,
            fl_x,
            fl_y,
            cx: self.cx.or(shared.cx),
            cy: self.cy.or(shared.cy),
            w: self.w.or(shared.w),
            h: self.h.or(shared.h),
            camera_model: self.camera_model.or_else(|| shared.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(shared.is_fisheye),
            k1: self.k1.or(shared.k1),
            k2: self.k2.or(shared.k2),
            k3: self.k3.or(shared.k3),
            k4: self.k4.or(shared.k4),
            p1: self.p1.or(shared.p1),
            p2: self.p2.or(shared.p2),
        }
    }

    /// The camera at the origin; `of` names it in messages and may be empty.
    fn camera(&self, reader: Reader<'_>, of: &str) -> Result<Camera, EngineError> {
        self.check_pinhole(reader, of)?;
        let width = side(reader, of, self.w, reader.size.width())?;
        let height = side(reader, of, self.h, reader.size.height())?;
        let size = reader.size(of, width, height)?;
        let focal = match (self.fl_x, self.camera_angle_x) {
            (Some(fx), _) => [fx, self.fl_y.unwrap_or(fx)],
            (None, Some(angle)) if angle > 0.0 && angle < std::f64::consts::PI => {
                [f64::from(size.width()) / (2.0 * (angle / 2.0).tan()); 2]
            }
            (None, Some(angle)) => {
                let field = format!("{of}camera_angle_x");
                return Err(bad_data(reader.path, field, angle, "an angle between 0 and pi"));
            }
            (None, None) => {
                let field = format!("{of}focal length");
                return Err(bad_data(reader.path, field, "missing", "camera_angle_x or fl_x"));
            }
        };
        reader.lens(of, size, focal, [self.cx, self.cy])
    }

    fn check_pinhole(&self, reader: Reader<'_>, of: &str) -> Result<(), EngineError> {
        if let Some(model) = self.camera_model.as_deref().filter(|model| !PINHOLES.contains(model)) {
            return Err(bad_data(reader.path, format!("{of}camera_model"), model, PINHOLES.join(", ")));
        }
        if self.is_fisheye == Some(true) {
            return Err(bad_data(reader.path, format!("{of}is_fisheye"), true, "false: a pinhole camera"));
        }
        let distortion = [self.k1, self.k2, self.k3, self.k4, self.p1, self.p2];
        match distortion.into_iter().flatten().find(|value| *value != 0.0) {
            Some(value) => {
                let expected = "undistorted images (all of k1…k4, p1, p2 zero)";
                Err(bad_data(reader.path, format!("{of}lens distortion"), value, expected))
            }
            None => Ok(()),
        }
    }
}

/// A side of the image in px; `otherwise` where the file does not tell.
#[allow(clippy::cast_possible_truncation, reason = "a whole number within u32, as was checked")]
fn side(reader: Reader<'_>, of: &str, given: Option<f64>, otherwise: u32) -> Result<u64, EngineError> {
    match given {
        None => Ok(otherwise.into()),
        Some(side) if side.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&side) => Ok(side as u64),
        Some(side) => Err(bad_data(reader.path, format!("{of}image size"), side, "a whole number of px")),
    }
}
