//! Data sets of Nerfies and HyperNeRF: a folder with `dataset.json`, `metadata.json` and `camera/ID.json`.

use std::collections::HashMap;
use std::path::{Component, Path};

use glam::{DMat3, DVec3};
use serde::Deserialize;

use super::grouped::Grouped;
use super::reader::Reader;
use crate::base::files::bad_data;
use crate::error::EngineError;
use crate::scene::camera::cameras::{Camera, CameraSet, FrameSize};

/// The file that makes a folder such a data set.
pub(super) const INDEX: &str = "dataset.json";

#[derive(Deserialize)]
struct Index {
    ids: Vec<String>,
}

#[derive(Deserialize)]
struct Metadata {
    warp_id: u32,
}

/// World-to-camera rotation with OpenCV axes. The distortion is read only to be told of.
#[derive(Deserialize)]
struct NerfiesCamera {
    orientation: [[f64; 3]; 3],
    position: [f64; 3],
    focal_length: f64,
    principal_point: Option<[f64; 2]>,
    skew: Option<f64>,
    pixel_aspect_ratio: Option<f64>,
    #[serde(default)]
    radial_distortion: Vec<f64>,
    #[serde(default)]
    tangential_distortion: Vec<f64>,
    image_size: [u32; 2],
}

/// Reads all images of the data set at `folder`, in its order, each at `warp_id / max(warp_id)`.
///
/// Distortion is ignored, with a warning: 4DGaussians trains on these images, which are distorted, as if they were not,
/// so a pinhole camera is the one that its models know. The principal point is honoured, although 4DGaussians takes
/// the middle; `scene.json` is not used, as 4DGaussians does not.
pub(super) fn read(folder: &Path, size: FrameSize) -> Result<CameraSet, EngineError> {
    let (index_path, metadata_path) = (folder.join(INDEX), folder.join("metadata.json"));
    let index = Reader { path: &index_path, size };
    let ids = index.json::<Index>("a Nerfies data set's list of images (ids)")?.ids;
    let metadata = Reader { path: &metadata_path, size };
    let metadata: HashMap<String, Metadata> = metadata.json("each image's warp_id")?;
    let mut moments = Vec::with_capacity(ids.len());
    for (number, id) in ids.iter().enumerate() {
        let mut parts = Path::new(id).components();
        if !matches!((parts.next(), parts.next()), (Some(Component::Normal(_)), None)) {
            return Err(bad_data(&index_path, format!("ids[{number}]"), id, "a name without folders"));
        }
        let Some(known) = metadata.get(id) else {
            return Err(bad_data(&metadata_path, id, "missing", "the warp_id of every image of dataset.json"));
        };
        moments.push(Some(f64::from(known.warp_id)));
    }
    // The smallest divisor keeps a single moment at time 0.
    let times = index.times(&moments, |number| format!("ids[{number}]"), f64::MIN_POSITIVE)?;
    let mut grouped = Grouped::default();
    let mut distorted = 0_usize;
    for (id, time) in ids.into_iter().zip(times) {
        let path = folder.join("camera").join(format!("{id}.json"));
        let reader = Reader { path: &path, size };
        let file: NerfiesCamera = reader.json("the camera of an image of dataset.json")?;
        let distortion = file.radial_distortion.iter().chain(&file.tangential_distortion);
        distorted += usize::from(distortion.into_iter().any(|value| *value != 0.0));
        grouped.add(id, file.camera(reader)?, time);
    }
    if distorted > 0 {
        tracing::warn!(
            path = %folder.display(),
            cameras = distorted,
            "lens distortion is ignored, as 4DGaussians ignores it in training"
        );
    }
    index.set(grouped.views)
}

impl NerfiesCamera {
    fn camera(&self, reader: Reader<'_>) -> Result<Camera, EngineError> {
        let rotation = DMat3::from_cols_array_2d(&self.orientation);
        let world_to_camera = reader.rigid("orientation and position", rotation, DVec3::from_array(self.position))?;
        if let Some(skew) = self.skew.filter(|skew| *skew != 0.0) {
            return Err(bad_data(reader.path, "skew", skew, "0: a pinhole camera"));
        }
        let [width, height] = self.image_size;
        let size = reader.size("", width.into(), height.into())?;
        let focal = [self.focal_length, self.focal_length * self.pixel_aspect_ratio.unwrap_or(1.0)];
        let principal = self.principal_point.map_or([None; 2], |point| point.map(Some));
        Ok(Camera { world_to_camera, ..reader.lens("", size, focal, principal)? })
    }
}
