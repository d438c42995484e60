//! Checks that all kinds of camera files share.

use std::fmt::Display;
use std::path::Path;

use glam::{DMat3, DMat4, DVec3, Mat4};
use serde::Deserialize;

use crate::base::files::{bad_data, read_file};
use crate::base::numbers::narrow;
use crate::error::EngineError;
use crate::scene::camera::cameras::{Camera, CameraSet, FrameSize, View, invert_rigid};

/// How far a stored rotation may be from orthonormal: camera files keep at least 4 digits.
pub(super) const ROTATION_TOLERANCE: f64 = 1e-3;

/// A file while it is read.
#[derive(Clone, Copy)]
pub(super) struct Reader<'a> {
    /// Where it is, for messages.
    pub(super) path: &'a Path,
    /// Image size where the file tells none.
    pub(super) size: FrameSize,
}

impl Reader<'_> {
    /// What `value` holds as one kind of file.
    pub(super) fn parse_as<T: for<'a> Deserialize<'a>>(&self, value: serde_json::Value) -> Result<T, EngineError> {
        let expected = "the fields of this kind of camera file";
        serde_json::from_value(value).map_err(|error| bad_data(self.path, "json", error, expected))
    }

    /// The whole file, `what` of the folder that was asked for.
    pub(super) fn json<T: for<'a> Deserialize<'a>>(&self, what: &str) -> Result<T, EngineError> {
        let bytes = read_file(self.path, what)?;
        crate::base::json::parse(self.path, "json", &bytes, what)
    }

    /// World-to-camera transform of an OpenGL camera-to-world matrix: y and z change their sign.
    pub(super) fn opengl_pose(&self, field: impl Display, rows: &[[f64; 4]; 4]) -> Result<Mat4, EngineError> {
        let matrix = self.affine(&field, rows)?;
        let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let rotation = DMat3::from_mat4(matrix) * flip;
        self.rigid(field, rotation, matrix.w_axis.truncate())
    }

    /// A matrix of which the last row is that of an affine transform.
    pub(super) fn affine(&self, field: impl Display, rows: &[[f64; 4]; 4]) -> Result<DMat4, EngineError> {
        if rows[3] != [0.0, 0.0, 0.0, 1.0] {
            return Err(bad_data(self.path, field, format!("last row {:?}", rows[3]), "[0, 0, 0, 1]"));
        }
        Ok(DMat4::from_cols_array_2d(rows).transpose())
    }

    /// Inverts a camera-to-world transform with OpenCV axes after checking that it is one.
    pub(super) fn rigid(&self, field: impl Display, rotation: DMat3, position: DVec3) -> Result<Mat4, EngineError> {
        let gram = rotation.transpose() * rotation;
        let orthonormal = gram.abs_diff_eq(DMat3::IDENTITY, ROTATION_TOLERANCE);
        let in_range = position.as_vec3().is_finite();
        if orthonormal && rotation.determinant() > 0.0 && in_range {
            return Ok(invert_rigid(rotation, position));
        }
        let got = format!("rotation {rotation}, position {position}");
        Err(bad_data(self.path, field, got, "a rotation and a finite position"))
    }

    /// A camera at the origin with `focal` lengths in px and, unless it is in the middle, a `principal` point in px
    /// from the image's left and upper edge; `of` names the camera in messages and may be empty.
    pub(super) fn lens(
        &self,
        of: &str,
        size: FrameSize,
        focal: [f64; 2],
        principal: [Option<f64>; 2],
    ) -> Result<Camera, EngineError> {
        if !focal.iter().all(|&f| f > 0.0 && narrow(f).is_finite()) {
            return Err(bad_data(self.path, format!("{of}focal length"), format!("{focal:?}"), "positive"));
        }
        let mut camera = Camera::with_focal(Mat4::IDENTITY, focal, size);
        for (coordinate, given) in [&mut camera.cx, &mut camera.cy].into_iter().zip(principal) {
            let Some(given) = given else { continue };
            // Such files count pixel edges, cameras count pixel centres.
            *coordinate = narrow(given - 0.5);
            if !coordinate.is_finite() {
                return Err(bad_data(self.path, format!("{of}principal point"), given, "a finite number"));
            }
        }
        Ok(camera)
    }

    /// A size that the file tells; `of` as in [`Reader::lens`].
    pub(super) fn size(&self, of: &str, width: u64, height: u64) -> Result<FrameSize, EngineError> {
        // What is beyond u32 is beyond the largest side too.
        let side = |side: u64| u32::try_from(side).unwrap_or(u32::MAX);
        FrameSize::new(side(width), side(height)).map_err(|error| match error {
            EngineError::Usage { expected, .. } => {
                bad_data(self.path, format!("{of}image size"), format!("{width}x{height}"), expected)
            }
            other => other,
        })
    }

    /// `times` of all frames, which are `named` in the file, scaled into \[0,1\]; none at all if no frame has one.
    ///
    /// They are divided by the largest of them and of `least`.
    pub(super) fn times(
        &self,
        times: &[Option<f64>],
        named: impl Fn(usize) -> String,
        least: f64,
    ) -> Result<Vec<Option<f32>>, EngineError> {
        if times.iter().all(Option::is_none) {
            return Ok(vec![None; times.len()]);
        }
        if let Some(number) = times.iter().position(Option::is_none) {
            return Err(bad_data(self.path, named(number), "missing", "a time in every frame or in none"));
        }
        for (number, time) in times.iter().enumerate() {
            if let Some(time) = time.filter(|time| !(0.0..f64::INFINITY).contains(time)) {
                return Err(bad_data(self.path, named(number), time, "at least 0"));
            }
        }
        let largest = times.iter().flatten().copied().fold(least, f64::max);
        Ok(times.iter().map(|time| time.map(|time| narrow(time / largest))).collect())
    }

    /// A set of `views` that do not follow each other.
    pub(super) fn set(&self, views: Vec<View>) -> Result<CameraSet, EngineError> {
        match views.is_empty() {
            true => Err(bad_data(self.path, "cameras", "none", "at least one")),
            false => Ok(CameraSet { views, in_sequence: false }),
        }
    }
}
