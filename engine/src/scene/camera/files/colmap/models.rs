//! Camera models (<https://colmap.github.io/cameras.html>), cameras and images as both forms have them.

use glam::{DMat3, DQuat, DVec3, DVec4, Mat4};

use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::camera::cameras::Camera;
use crate::scene::camera::files::reader::{ROTATION_TOLERANCE, Reader};

/// Longest name of an image that is believed, bytes: the longest path of Linux.
pub(super) const MAX_NAME: usize = 4096;

/// A camera model. Its parameters are focal lengths, principal point, then what bends the image.
pub(super) struct Model {
    pub(super) name: &'static str,
    /// 1 or 2.
    pub(super) focal_lengths: usize,
    /// Parameters behind the principal point.
    pub(super) distortion: usize,
    /// Whether it is a pinhole camera once its distortion is zero.
    pub(super) pinhole: bool,
}

const fn model(name: &'static str, focal_lengths: usize, distortion: usize, pinhole: bool) -> Model {
    Model { name, focal_lengths, distortion, pinhole }
}

/// By their number in binary files.
pub(super) const MODELS: [Model; 12] = [
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
    pub(super) fn parameters(&self) -> usize {
        self.focal_lengths + 2 + self.distortion
    }
}

/// An entry of `cameras`.
pub(super) struct ColmapCamera {
    pub(super) id: u32,
    pub(super) model: &'static Model,
    pub(super) width: u64,
    pub(super) height: u64,
    /// As many as the model has.
    pub(super) parameters: Vec<f64>,
}

/// An entry of `images`: a world-to-camera transform with OpenCV axes.
pub(super) struct ColmapImage {
    pub(super) id: u32,
    /// w, x, y, z.
    pub(super) rotation: [f64; 4],
    pub(super) translation: [f64; 3],
    pub(super) camera_id: u32,
    pub(super) name: String,
}

impl ColmapCamera {
    /// The camera at the origin.
    pub(super) fn lens(&self, reader: Reader<'_>) -> Result<Camera, EngineError> {
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
    pub(super) fn pose(&self, reader: Reader<'_>) -> Result<Mat4, EngineError> {
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
