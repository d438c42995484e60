//! Opening whatever holds cameras: which of the known kinds a file or folder is.
//!
//! | kind | given as | poses | pixels | time |
//! |---|---|---|---|---|
//! | D-NeRF, Blender, nerfstudio transforms | file | camera to world, OpenGL axes | edges | of a frame, if it has one |
//! | INRIA `cameras.json` | file | camera to world, OpenCV axes | symmetric | none |
//! | nerfstudio `camera_path.json` | file | camera to world, OpenGL axes | symmetric | `render_time`, or 0 to 1 |
//! | one camera for `guard4d dump` | file | world to camera, OpenCV axes | symmetric | optional |
//! | COLMAP reconstruction, text or binary | folder | world to camera, OpenCV axes | edges | none |
//! | Nerfies and HyperNeRF data set | folder | world to camera, OpenCV axes | edges | `warp_id` |
//!
//! OpenGL axes are x right, y up, z backward; OpenCV axes are x right, y down, z forward. Pixels that count from edges
//! put the middle of the first pixel at 0.5 and are moved by that, because a [`Camera`](crate::scene::Camera) puts it
//! at 0.

use std::path::Path;

use super::reader::Reader;
use super::{camera_path, colmap, inria, nerfies, single, transforms};
use crate::base::files::{bad_data, read_file};
use crate::error::EngineError;
use crate::scene::camera::cameras::{CameraSet, FrameSize};

/// What a file may hold, for messages.
const FILE_KINDS: &str = "transforms (frames[].transform_matrix), INRIA cameras.json, nerfstudio camera_path.json, or \
                          one world_to_camera_row_major; COLMAP and Nerfies cameras are given as their folder";

/// What a folder may hold, for messages.
const FOLDER_KINDS: &str = "COLMAP's cameras and images as .bin or .txt, in it, in sparse/0 or in sparse, or a Nerfies \
                            data set with dataset.json; other cameras are given as their file";

impl CameraSet {
    /// Reads a camera file or folder of any known kind; `size` is used where it does not tell the image size.
    ///
    /// Frames of one camera become one [`View`](crate::scene::View). A file of a D-NeRF dataset has its times divided
    /// by the largest time of the dataset's training and test files, as 4DGaussians does when it trains; any other file
    /// only if a time is above 1, and then by its own largest. Poses are taken as they stand, as a model that was
    /// trained from the same file saw them: nerfstudio's `applied_transform` only tells what they went through before.
    /// COLMAP's images come in the order of their names.
    ///
    /// # Errors
    /// [`EngineError::MissingInput`], [`EngineError::Io`], [`EngineError::BadData`] for a folder without cameras, and
    /// those of [`CameraSet::parse`], also for the dataset's other file.
    pub fn open(path: &Path, size: FrameSize) -> Result<Self, EngineError> {
        if !path.is_dir() {
            let json = read_file(path, "a camera file or folder")?;
            return read(Reader { path, size }, &json, transforms::dataset_end(path)?);
        }
        if let Some(files) = colmap::Files::find(path) {
            return files.read(size);
        }
        match path.join(nerfies::INDEX).is_file() {
            true => nerfies::read(path, size),
            false => Err(bad_data(path, "folder", "no cameras", FOLDER_KINDS)),
        }
    }

    /// Parses `json`, which came from the file at `path`, without looking at other files.
    ///
    /// # Errors
    /// [`EngineError::BadData`] naming the frame and field that is malformed, not finite, or no rigid transform, and
    /// for lens distortion, which is not rendered.
    pub fn parse(path: &Path, json: &[u8], size: FrameSize) -> Result<Self, EngineError> {
        read(Reader { path, size }, json, None)
    }
}

fn read(reader: Reader<'_>, json: &[u8], dataset_end: Option<f64>) -> Result<CameraSet, EngineError> {
    let value: serde_json::Value = crate::base::json::parse(reader.path, "json", json, FILE_KINDS)?;
    if value.is_array() {
        return inria::read(reader, value);
    }
    if value.get("frames").is_some() {
        return transforms::read(reader, value, dataset_end);
    }
    if value.get("camera_path").is_some() {
        return camera_path::read(reader, value);
    }
    if value.get("world_to_camera_row_major").is_some() {
        return single::read(reader, value);
    }
    Err(bad_data(reader.path, "json", "another kind of file", FILE_KINDS))
}
