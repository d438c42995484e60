//! Where a reconstruction lies in a folder, and its images as views (<https://colmap.github.io/format.html>).

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::{binary, text};
use crate::base::files::{bad_data, read_file};
use crate::error::EngineError;
use crate::scene::camera::cameras::{Camera, CameraSet, FrameSize, View};
use crate::scene::camera::files::reader::Reader;

/// Where a reconstruction lies in the folder that is asked for: itself, or where COLMAP's data sets keep it.
const PLACES: [&str; 3] = ["", "sparse/0", "sparse"];

#[derive(Clone, Copy)]
enum Form {
    Binary,
    Text,
}

/// The two files of a reconstruction.
pub(in crate::scene::camera::files) struct Files {
    cameras: PathBuf,
    images: PathBuf,
    form: Form,
}

impl Files {
    /// Those in or below `folder`, whole pairs and binary files first, as COLMAP itself takes them. A single file
    /// counts too, so that the other is missed when they are read.
    pub(in crate::scene::camera::files) fn find(folder: &Path) -> Option<Self> {
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
    pub(in crate::scene::camera::files) fn read(&self, size: FrameSize) -> Result<CameraSet, EngineError> {
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
            Ok(View { name: image.name, camera: Camera { world_to_camera, ..*lens }, times: Vec::new(), located: true })
        });
        reader.set(views.collect::<Result<_, _>>()?)
    }
}
