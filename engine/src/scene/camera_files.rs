//! Camera files: D-NeRF/nerfstudio transforms, INRIA `cameras.json`, and a single camera.

use std::collections::HashMap;
use std::path::Path;

use glam::{DMat3, DMat4, DVec3, Mat4};
use serde::Deserialize;

use super::camera::{Camera, CameraSet, ImageSize, View, invert_rigid};
use super::{bad_data, narrow, read_file};
use crate::error::EngineError;

/// Files of one D-NeRF dataset. Its times are divided by the largest of the first two, whichever file is read.
const DATASET: [&str; 3] = ["transforms_train.json", "transforms_test.json", "transforms_val.json"];

/// How far a stored rotation may be from orthonormal: camera files keep at least 4 digits.
const ROTATION_TOLERANCE: f64 = 1e-3;

/// `transforms_*.json`; camera-to-world matrices with OpenGL axes (x right, y up, z backward).
#[derive(Deserialize)]
struct Transforms {
    camera_angle_x: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<u32>,
    h: Option<u32>,
    #[serde(flatten)]
    distortion: Distortion,
    frames: Vec<Frame>,
}

/// Lens distortion, which is not rendered.
#[derive(Deserialize)]
struct Distortion {
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
    transform_matrix: [[f64; 4]; 4],
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

/// One entry of INRIA's `cameras.json`; camera-to-world rotation with OpenCV axes.
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

/// A file with one camera.
#[derive(Deserialize)]
struct SingleCamera {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    world_to_camera_row_major: [[f64; 4]; 4],
    time: Option<f64>,
}

impl CameraSet {
    /// Reads a camera file of any known kind; `size` is used where the file does not tell the image size.
    ///
    /// Frames of one camera become one [`View`]. A file of a D-NeRF dataset has its times divided by the largest time
    /// of the dataset's training and test files, as 4DGaussians does when it trains; any other file only if a time is
    /// above 1, and then by its own largest.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], and those of [`CameraSet::parse`], also for the dataset's
    /// other file.
    pub fn open(path: &Path, size: ImageSize) -> Result<Self, EngineError> {
        let json = read_file(path, "a camera file")?;
        Reader { path, size, dataset_end: dataset_end(path)? }.read(&json)
    }

    /// Parses `json`, which came from `path`, without looking at other files.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the frame and field that is malformed, not finite, or no rigid transform, and for
    /// lens distortion, which is not rendered.
    pub fn parse(path: &Path, json: &[u8], size: ImageSize) -> Result<Self, EngineError> {
        Reader { path, size, dataset_end: None }.read(json)
    }
}

/// Largest time of the dataset's other files, if `path` is one of a dataset that has both a training and a test file.
fn dataset_end(path: &Path) -> Result<Option<f64>, EngineError> {
    let [train, test, _] = DATASET.map(|name| path.with_file_name(name));
    let of_dataset = path.file_name().is_some_and(|name| DATASET.iter().any(|known| name == *known));
    if !(of_dataset && train.is_file() && test.is_file()) {
        return Ok(None);
    }
    let mut end: Option<f64> = None;
    for file in [train, test].iter().filter(|file| *file != path) {
        let expected = "frames with their times, as in the dataset's other files";
        let times: Times = serde_json::from_slice(&read_file(file, "a camera file")?)
            .map_err(|error| bad_data(file, "json", error, expected))?;
        end = times.frames.into_iter().filter_map(|frame| frame.time).chain(end).reduce(f64::max);
    }
    Ok(end)
}

fn parse_as<T: for<'a> Deserialize<'a>>(path: &Path, value: serde_json::Value) -> Result<T, EngineError> {
    serde_json::from_value(value)
        .map_err(|error| bad_data(path, "json", error, "the fields of this kind of camera file"))
}

struct Reader<'a> {
    path: &'a Path,
    size: ImageSize,
    /// Largest time of the dataset's other files.
    dataset_end: Option<f64>,
}

impl Reader<'_> {
    fn read(&self, json: &[u8]) -> Result<CameraSet, EngineError> {
        let path = self.path;
        let kinds = "transforms (frames[].transform_matrix), INRIA cameras.json, or one world_to_camera_row_major";
        let value: serde_json::Value =
            serde_json::from_slice(json).map_err(|error| bad_data(path, "json", error, kinds))?;
        if value.is_array() {
            return self.inria(parse_as(path, value)?);
        }
        if value.get("frames").is_some() {
            return self.transforms(parse_as(path, value)?);
        }
        if value.get("world_to_camera_row_major").is_some() {
            return self.single(parse_as(path, value)?);
        }
        Err(bad_data(path, "json", "another kind of file", kinds))
    }

    fn transforms(&self, file: Transforms) -> Result<CameraSet, EngineError> {
        let lens = self.lens(&file)?;
        let mut times = self.times(&file.frames)?.into_iter();
        let mut views: Vec<View> = Vec::new();
        let mut index_from_pose: HashMap<[u32; 16], usize> = HashMap::new();
        for (number, frame) in file.frames.into_iter().enumerate() {
            let field = format!("frames[{number}].transform_matrix");
            let world_to_camera = self.opengl_pose(&field, &frame.transform_matrix)?;
            let pose = world_to_camera.to_cols_array().map(f32::to_bits);
            let index = *index_from_pose.entry(pose).or_insert(views.len());
            if index == views.len() {
                views.push(View {
                    name: frame.file_path.unwrap_or_else(|| format!("frame_{number:05}")),
                    camera: Camera { world_to_camera, ..lens },
                    times: Vec::new(),
                });
            }
            views[index].times.extend(times.next());
        }
        self.not_empty(views)
    }

    /// The camera that all frames share, but for its pose.
    fn lens(&self, file: &Transforms) -> Result<Camera, EngineError> {
        let d = &file.distortion;
        let distortion = [d.k1, d.k2, d.k3, d.k4, d.p1, d.p2];
        if let Some(value) = distortion.into_iter().flatten().find(|value| *value != 0.0) {
            let expected = "undistorted images (all of k1…k4, p1, p2 zero)";
            return Err(bad_data(self.path, "lens distortion", value, expected));
        }
        let width = file.w.unwrap_or(self.size.width());
        let size = self.size(width, file.h.unwrap_or(self.size.height()))?;
        let mut camera = match (file.fl_x, file.camera_angle_x) {
            (Some(fx), _) => {
                let focal = self.focal([fx, file.fl_y.unwrap_or(fx)])?;
                Camera::with_focal(Mat4::IDENTITY, focal, size)
            }
            (None, Some(angle)) if angle > 0.0 && angle < std::f64::consts::PI => {
                Camera::with_fov(Mat4::IDENTITY, angle, size)
            }
            (None, Some(angle)) => {
                let expected = "an angle between 0 and pi";
                return Err(bad_data(self.path, "camera_angle_x", angle, expected));
            }
            (None, None) => {
                let expected = "camera_angle_x or fl_x";
                return Err(bad_data(self.path, "focal length", "missing", expected));
            }
        };
        // These files count pixel edges, cameras count pixel centres.
        if let Some(cx) = file.cx {
            camera.cx = narrow(cx - 0.5);
        }
        if let Some(cy) = file.cy {
            camera.cy = narrow(cy - 0.5);
        }
        Ok(camera)
    }

    /// One time per frame, scaled into \[0,1\], or none at all if no frame has one.
    fn times(&self, frames: &[Frame]) -> Result<Vec<f32>, EngineError> {
        let times: Vec<f64> = frames.iter().filter_map(|frame| frame.time).collect();
        if times.is_empty() {
            return Ok(Vec::new());
        }
        if let Some(number) = frames.iter().position(|frame| frame.time.is_none()) {
            let field = format!("frames[{number}].time");
            return Err(bad_data(self.path, field, "missing", "a time in every frame or in none"));
        }
        if let Some(number) = times.iter().position(|time| !(0.0..f64::INFINITY).contains(time)) {
            let field = format!("frames[{number}].time");
            return Err(bad_data(self.path, field, times[number], "at least 0"));
        }
        // A file on its own is taken at its word up to 1: it may be a part of a dataset that ends later.
        let least = self.dataset_end.filter(|end| *end > 0.0).unwrap_or(1.0);
        let largest = times.iter().copied().fold(least, f64::max);
        Ok(times.into_iter().map(|time| narrow(time / largest)).collect())
    }

    fn inria(&self, cameras: Vec<InriaCamera>) -> Result<CameraSet, EngineError> {
        let views = cameras.into_iter().enumerate().map(|(number, camera)| {
            let field = format!("[{number}].rotation");
            let rotation = DMat3::from_cols_array_2d(&camera.rotation).transpose();
            let position = DVec3::from_array(camera.position);
            let world_to_camera = self.rigid(&field, rotation, position)?;
            let size = self.size(camera.width, camera.height)?;
            let focal = self.focal([camera.fx, camera.fy])?;
            Ok(View {
                name: camera.img_name,
                camera: Camera::with_focal(world_to_camera, focal, size),
                times: Vec::new(),
            })
        });
        self.not_empty(views.collect::<Result<_, EngineError>>()?)
    }

    fn single(&self, file: SingleCamera) -> Result<CameraSet, EngineError> {
        let field = "world_to_camera_row_major";
        let matrix = self.affine(field, &file.world_to_camera_row_major)?;
        // Inverted twice, so that one function checks all poses.
        let rotation = DMat3::from_mat4(matrix).transpose();
        let position = -(rotation * matrix.w_axis.truncate());
        self.rigid(field, rotation, position)?;
        let focal = self.focal([file.fx, file.fy])?;
        let size = self.size(file.width, file.height)?;
        let time = file.time.filter(|time| !(0.0..=1.0).contains(time));
        if let Some(time) = time {
            return Err(bad_data(self.path, "time", time, "0 to 1"));
        }
        self.not_empty(vec![View {
            name: "camera".to_owned(),
            camera: Camera::with_focal(matrix.as_mat4(), focal, size),
            times: file.time.map(narrow).into_iter().collect(),
        }])
    }

    /// World-to-camera transform of an OpenGL camera-to-world matrix: y and z change their sign.
    fn opengl_pose(&self, field: &str, rows: &[[f64; 4]; 4]) -> Result<Mat4, EngineError> {
        let matrix = self.affine(field, rows)?;
        let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let rotation = DMat3::from_mat4(matrix) * flip;
        self.rigid(field, rotation, matrix.w_axis.truncate())
    }

    fn affine(&self, field: &str, rows: &[[f64; 4]; 4]) -> Result<DMat4, EngineError> {
        if rows[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(bad_data(self.path, field, format!("last row {:?}", rows[3]), "[0, 0, 0, 1]"));
        }
        Ok(DMat4::from_cols_array_2d(rows).transpose())
    }

    /// Inverts a camera-to-world transform after checking that it is one.
    fn rigid(&self, field: &str, rotation: DMat3, position: DVec3) -> Result<Mat4, EngineError> {
        let gram = rotation.transpose() * rotation;
        let orthonormal = gram.abs_diff_eq(DMat3::IDENTITY, ROTATION_TOLERANCE);
        let in_range = position.as_vec3().is_finite();
        if orthonormal && rotation.determinant() > 0.0 && in_range {
            return Ok(invert_rigid(rotation, position));
        }
        let got = format!("rotation {rotation}, position {position}");
        Err(bad_data(self.path, field, got, "a rotation and a finite position"))
    }

    fn focal(&self, focal: [f64; 2]) -> Result<[f64; 2], EngineError> {
        match focal.iter().all(|&f| f > 0.0 && narrow(f).is_finite()) {
            true => Ok(focal),
            false => Err(bad_data(self.path, "focal length", format!("{focal:?}"), "positive")),
        }
    }

    fn size(&self, width: u32, height: u32) -> Result<ImageSize, EngineError> {
        let bad = |error: EngineError| match error {
            EngineError::Usage { got, expected, .. } => bad_data(self.path, "image size", got, expected),
            other => other,
        };
        ImageSize::new(width, height).map_err(bad)
    }

    fn not_empty(&self, views: Vec<View>) -> Result<CameraSet, EngineError> {
        match views.is_empty() {
            true => Err(bad_data(self.path, "cameras", "none", "at least one")),
            false => Ok(CameraSet { views }),
        }
    }
}
