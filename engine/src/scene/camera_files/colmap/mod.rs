//! COLMAP reconstructions: `cameras` and `images`, as text or binary; points are not read.
//!
//! Formats: <https://colmap.github.io/format.html>, models: <https://colmap.github.io/cameras.html>.

mod binary;
mod text;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3, DVec4, Mat4};

use super::super::camera::{Camera, CameraSet, ImageSize, View};
use super::super::{bad_data, read_file};
use super::reader::{ROTATION_TOLERANCE, Reader};
use crate::error::EngineError;

/// Where a reconstruction lies in the folder that is asked for: itself, or where COLMAP's data sets keep it.
const PLACES: [&str; 3] = ["", "sparse/0", "sparse"];

/// Longest name of an image that is believed, bytes: the longest path of Linux.
const MAX_NAME: usize = 4096;

/// A camera model. Its parameters are focal lengths, principal point, then what bends the image.
struct Model {
    name: &'static str,
    /// 1 or 2.
    focal_lengths: usize,
    /// Parameters behind the principal point.
    distortion: usize,
    /// Whether it is a pinhole camera once its distortion is zero.
    pinhole: bool,
}

const fn model(name: &'static str, focal_lengths: usize, distortion: usize, pinhole: bool) -> Model {
    Model { name, focal_lengths, distortion, pinhole }
}

/// By their number in binary files.
const MODELS: [Model; 12] = [
    model("SIMPLE_PINHOLE", 1, 0, true),
    model("PINHOLE", 2, 0, true),
    model("SIMPLE_RADIAL", 1, 1, true),
    model("RADIAL", 1, 2, true),
    model("OPENCV", 2, 4, true),
    model("OPENCV_FISHEYE", 2, 4, false),
    model("FULL_OPENCV", 2, 8, true),
    model("FOV", 2, 1, true),
    model("SIMPLE_RADIAL_FISHEYE", 1, 1, false),
    model("RADIAL_FISHEYE", 1, 2, false),
    model("THIN_PRISM_FISHEYE", 2, 8, false),
    model("RAD_TAN_THIN_PRISM_FISHEYE", 2, 12, false),
];

impl Model {
    /// How many numbers its cameras have.
    fn parameters(&self) -> usize {
        self.focal_lengths + 2 + self.distortion
    }
}

/// An entry of `cameras`.
struct ColmapCamera {
    id: u32,
    model: &'static Model,
    width: u64,
    height: u64,
    /// As many as the model has.
    parameters: Vec<f64>,
}

/// An entry of `images`: a world-to-camera transform with OpenCV axes.
struct ColmapImage {
    id: u32,
    /// w, x, y, z.
    rotation: [f64; 4],
    translation: [f64; 3],
    camera_id: u32,
    name: String,
}

#[derive(Clone, Copy)]
enum Form {
    Binary,
    Text,
}

/// The two files of a reconstruction.
pub(super) struct Files {
    cameras: PathBuf,
    images: PathBuf,
    form: Form,
}

impl Files {
    /// Those in or below `folder`, whole pairs and binary files first, as COLMAP itself takes them. A single file counts
    /// too, so that the other is missed when they are read.
    pub(super) fn find(folder: &Path) -> Option<Self> {
        let places = PLACES.iter().map(|place| folder.join(place));
        let pairs: Vec<Self> =
            places.flat_map(|place| [Form::Binary, Form::Text].map(|f| Self::at(&place, f))).collect();
        let whole = pairs.iter().position(|pair| pair.cameras.is_file() && pair.images.is_file());
        let part = pairs.iter().position(|pair| pair.cameras.is_file() || pair.images.is_file());
        pairs.into_iter().nth(whole.or(part)?)
    }

    fn at(place: &Path, form: Form) -> Self {
        let extension = match form {
            Form::Binary => "bin",
            Form::Text => "txt",
        };
        let file = |stem: &str| place.join(stem).with_extension(extension);
        Self { cameras: file("cameras"), images: file("images"), form }
    }

    /// The views in the order of their names; none has a time.
    pub(super) fn read(&self, size: ImageSize) -> Result<CameraSet, EngineError> {
        let cameras_file = read_file(&self.cameras, "COLMAP's cameras")?;
        let images_file = read_file(&self.images, "COLMAP's images")?;
        let (cameras, mut images) = match self.form {
            Form::Binary => {
                (binary::cameras(&self.cameras, &cameras_file)?, binary::images(&self.images, &images_file)?)
            }
            Form::Text => (text::cameras(&self.cameras, &cameras_file)?, text::images(&self.images, &images_file)?),
        };
        let reader = Reader { path: &self.cameras, size };
        let mut lens_from_id = HashMap::new();
        for camera in cameras {
            let id = camera.id;
            if lens_from_id.insert(id, camera.lens(reader)?).is_some() {
                return Err(bad_data(
                    &self.cameras,
                    format!("camera {id}"),
                    "there twice",
                    "one camera of each number",
                ));
            }
        }
        images.sort_by(|a, b| a.name.cmp(&b.name));
        let reader = Reader { path: &self.images, size };
        let views = images.into_iter().map(|image| {
            let Some(lens) = lens_from_id.get(&image.camera_id) else {
                let field = format!("image {}: camera", image.id);
                return Err(bad_data(&self.images, field, image.camera_id, "a camera of the cameras file"));
            };
            let world_to_camera = image.pose(reader)?;
            Ok(View { name: image.name, camera: Camera { world_to_camera, ..*lens }, times: Vec::new() })
        });
        reader.set(views.collect::<Result<_, _>>()?)
    }
}

impl ColmapCamera {
    /// The camera at the origin.
    fn lens(&self, reader: Reader<'_>) -> Result<Camera, EngineError> {
        let of = format!("camera {}: ", self.id);
        let size = reader.size(&of, self.width, self.height)?;
        let undistorted = "a pinhole camera without distortion: what COLMAP's image_undistorter writes";
        if !self.model.pinhole {
            return Err(bad_data(reader.path, format!("{of}model"), self.model.name, undistorted));
        }
        let (focal, rest) = self.parameters.split_at(self.model.focal_lengths);
        let (principal, distortion) = rest.split_at(2);
        if let Some(value) = distortion.iter().find(|value| **value != 0.0) {
            return Err(bad_data(reader.path, format!("{of}lens distortion"), value, undistorted));
        }
        let focal = [focal[0], focal[self.model.focal_lengths - 1]];
        reader.lens(&of, size, focal, [Some(principal[0]), Some(principal[1])])
    }
}

impl ColmapImage {
    fn pose(&self, reader: Reader<'_>) -> Result<Mat4, EngineError> {
        let [w, x, y, z] = self.rotation;
        let quaternion = DVec4::new(x, y, z, w);
        let field = format!("image {}: rotation", self.id);
        // Both readers have refused what is not finite.
        if (quaternion.length() - 1.0).abs() > ROTATION_TOLERANCE {
            return Err(bad_data(reader.path, field, format!("{:?}", self.rotation), "a quaternion of length 1"));
        }
        let camera_to_world = DMat3::from_quat(DQuat::from_vec4(quaternion.normalize())).transpose();
        let position = -(camera_to_world * DVec3::from_array(self.translation));
        reader.rigid(format!("image {}: pose", self.id), camera_to_world, position)
    }
}
