//! One camera in the words of each program, written from its axes and nothing of the readers.

use std::fs;
use std::path::{Path, PathBuf};

use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};

/// A pinhole camera with OpenCV axes: the columns of `axes` are its right, down and forward in the world.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shot {
    pub(crate) axes: DMat3,
    pub(crate) position: DVec3,
    /// px
    pub(crate) focal: [f64; 2],
    /// px from the image's left and upper edge
    pub(crate) principal: [f64; 2],
    pub(crate) size: [u32; 2],
}

impl Shot {
    /// A camera at `position` that looks at `target`, upright if z is up, with square pixels and its axis in the
    /// middle.
    pub(crate) fn looking(position: DVec3, target: DVec3, focal: f64, size: [u32; 2]) -> Self {
        let forward = (target - position).normalize();
        let right = forward.cross(DVec3::Z).normalize();
        let axes = DMat3::from_cols(right, forward.cross(right), forward);
        Self { axes, position, focal: [focal; 2], principal: size.map(|side| f64::from(side) / 2.0), size }
    }

    /// Row-major camera-to-world matrix with OpenGL axes: right, up, backward.
    fn opengl(&self) -> [[f64; 4]; 4] {
        let (right, up, back) = (self.axes.x_axis, -self.axes.y_axis, -self.axes.z_axis);
        let row = |i: usize| [right[i], up[i], back[i], self.position[i]];
        [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
    }

    /// World-to-camera rotation as w, x, y, z, and translation.
    pub(crate) fn colmap(&self) -> ([f64; 4], [f64; 3]) {
        let rotation = self.axes.transpose();
        let q = DQuat::from_mat3(&rotation);
        ([q.w, q.x, q.y, q.z], (-(rotation * self.position)).to_array())
    }

    /// The rows of world-to-camera rotation, which are the columns of `axes`.
    fn rows(&self) -> [[f64; 3]; 3] {
        self.axes.to_cols_array_2d()
    }
}

/// Kinds of camera files and folders.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Format {
    Dnerf,
    Nerfstudio,
    /// With a lens in every frame.
    NerfstudioFrames,
    ColmapText,
    ColmapBinary,
    Inria,
    Nerfies,
    CameraPath,
}

impl Format {
    pub(crate) const ALL: [Self; 8] = [
        Self::Dnerf,
        Self::Nerfstudio,
        Self::NerfstudioFrames,
        Self::ColmapText,
        Self::ColmapBinary,
        Self::Inria,
        Self::Nerfies,
        Self::CameraPath,
    ];

    /// Whether it can tell two focal lengths and a principal point.
    pub(crate) fn has_lens(self) -> bool {
        !matches!(self, Self::Dnerf | Self::Inria | Self::CameraPath)
    }

    /// Writes `shots` below `folder`, which has nothing of this format yet; gives what `CameraSet::open` is to be
    /// given.
    pub(crate) fn write(self, folder: &Path, shots: &[Shot]) -> PathBuf {
        let file = |name: &str, value: Value| put(folder, name, value.to_string().as_bytes());
        match self {
            Self::Dnerf => file("dnerf.json", dnerf(shots)),
            Self::Nerfstudio => file("nerfstudio.json", nerfstudio(shots)),
            Self::NerfstudioFrames => file("nerfstudio_frames.json", nerfstudio_frames(shots)),
            Self::Inria => file("cameras.json", shots.iter().enumerate().map(inria).collect()),
            Self::CameraPath => file("camera_path.json", camera_path(shots)),
            Self::ColmapText => {
                let (cameras, images) = colmap_text(shots);
                put(folder, "text/cameras.txt", cameras.as_bytes());
                put(folder, "text/images.txt", images.as_bytes());
                folder.join("text")
            }
            Self::ColmapBinary => {
                let (cameras, images) = colmap_binary(shots);
                put(folder, "binary/sparse/0/cameras.bin", &cameras);
                put(folder, "binary/sparse/0/images.bin", &images);
                folder.join("binary")
            }
            Self::Nerfies => {
                nerfies(&folder.join("nerfies"), shots);
                folder.join("nerfies")
            }
        }
    }
}

/// Writes a file and the folders that it lies in.
pub(crate) fn put(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().expect("a file lies in a folder")).expect("a temporary folder is writable");
    fs::write(&path, bytes).expect("a temporary folder is writable");
    path
}

fn frame((number, shot): (usize, &Shot)) -> Value {
    json!({ "file_path": format!("images/{number:03}"), "transform_matrix": shot.opengl() })
}

/// One lens for all: that of the first shot.
fn dnerf(shots: &[Shot]) -> Value {
    let angle = 2.0 * (f64::from(shots[0].size[0]) / 2.0 / shots[0].focal[0]).atan();
    json!({ "camera_angle_x": angle, "frames": shots.iter().enumerate().map(frame).collect::<Value>() })
}

fn lens(shot: &Shot) -> Value {
    json!({ "fl_x": shot.focal[0], "fl_y": shot.focal[1], "cx": shot.principal[0], "cy": shot.principal[1],
            "w": shot.size[0], "h": shot.size[1], "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0 })
}

fn nerfstudio(shots: &[Shot]) -> Value {
    let mut file = lens(&shots[0]);
    file["camera_model"] = json!("OPENCV");
    file["applied_transform"] = json!([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0]]);
    file["frames"] = shots.iter().enumerate().map(frame).collect();
    file
}

fn nerfstudio_frames(shots: &[Shot]) -> Value {
    let frames = shots.iter().enumerate().map(|(number, shot)| {
        let mut frame = frame((number, shot));
        let mut own = lens(shot);
        frame.as_object_mut().expect("an object").append(own.as_object_mut().expect("an object"));
        frame
    });
    json!({ "camera_model": "PINHOLE", "frames": frames.collect::<Value>() })
}

fn inria((number, shot): (usize, &Shot)) -> Value {
    // Camera to world: the transposed rows.
    let rotation = shot.axes.transpose().to_cols_array_2d();
    json!({ "id": number, "img_name": format!("{number:03}"), "width": shot.size[0], "height": shot.size[1],
            "position": shot.position.to_array(), "rotation": rotation, "fx": shot.focal[0], "fy": shot.focal[1] })
}

fn camera_path(shots: &[Shot]) -> Value {
    let [width, height] = shots[0].size;
    let stop = |shot: &Shot| {
        let fov = 2.0 * (f64::from(height) / 2.0 / shot.focal[1]).atan().to_degrees();
        json!({ "camera_to_world": shot.opengl().concat(), "fov": fov, "aspect": f64::from(width) / f64::from(height) })
    };
    json!({ "camera_type": "perspective", "render_width": width, "render_height": height, "fps": 24, "seconds": 1,
            "keyframes": [], "camera_path": shots.iter().map(stop).collect::<Value>() })
}

fn colmap_text(shots: &[Shot]) -> (String, String) {
    let mut cameras = "# Camera list with one line of data per camera:\n".to_owned();
    let mut images = "# Image list with two lines of data per image:\n".to_owned();
    for (number, shot) in shots.iter().enumerate() {
        let (id, [fx, fy], [cx, cy], [w, h]) = (number + 1, shot.focal, shot.principal, shot.size);
        let ([qw, qx, qy, qz], [tx, ty, tz]) = shot.colmap();
        cameras += &format!("{id} OPENCV {w} {h} {fx} {fy} {cx} {cy} 0 0 0 0\n");
        images += &format!("{} {qw} {qx} {qy} {qz} {tx} {ty} {tz} {id} {number:03}.png\n", id + 10);
        images += ["\n", "1.5 2.5 7 3.5 4.5 -1\n"][number % 2];
    }
    (cameras, images)
}

/// `cameras.bin` with model PINHOLE, and `images.bin`; the first image has no points, the second one has two, and so
/// on.
pub(crate) fn colmap_binary(shots: &[Shot]) -> (Vec<u8>, Vec<u8>) {
    let count = (shots.len() as u64).to_le_bytes();
    let (mut cameras, mut images) = (count.to_vec(), count.to_vec());
    for (number, shot) in shots.iter().enumerate() {
        let id = (number as u32 + 1).to_le_bytes();
        cameras.extend([id, 1_i32.to_le_bytes()].concat());
        cameras.extend(shot.size.map(|side| u64::from(side).to_le_bytes()).concat());
        cameras.extend([shot.focal, shot.principal].concat().into_iter().flat_map(f64::to_le_bytes));
        let (rotation, translation) = shot.colmap();
        images.extend((number as u32 + 11).to_le_bytes());
        images.extend(rotation.into_iter().chain(translation).flat_map(f64::to_le_bytes));
        images.extend(id);
        images.extend(format!("{number:03}.png\0").bytes());
        let points = 2 * (number as u64 % 2);
        images.extend(points.to_le_bytes());
        images.extend((0..points).flat_map(|point| [[0x5a; 16].as_slice(), &point.to_le_bytes()].concat()));
    }
    (cameras, images)
}

fn nerfies(folder: &Path, shots: &[Shot]) {
    let ids: Vec<String> = (0..shots.len()).map(|number| format!("{number:06}")).collect();
    let metadata = |number: usize| json!({ "warp_id": number, "appearance_id": number, "camera_id": 0 });
    let metadata: serde_json::Map<_, _> = (0..shots.len()).map(|n| (ids[n].clone(), metadata(n))).collect();
    put(folder, "metadata.json", Value::Object(metadata).to_string().as_bytes());
    let index = json!({ "count": ids.len(), "ids": ids, "train_ids": ids, "val_ids": [] });
    put(folder, "dataset.json", index.to_string().as_bytes());
    for (id, shot) in ids.iter().zip(shots) {
        let camera = json!({
            "orientation": shot.rows(), "position": shot.position.to_array(), "focal_length": shot.focal[0],
            "pixel_aspect_ratio": shot.focal[1] / shot.focal[0], "principal_point": shot.principal, "skew": 0.0,
            "radial_distortion": [0.0, 0.0, 0.0], "tangential_distortion": [0.0, 0.0], "image_size": shot.size,
        });
        put(folder, &format!("camera/{id}.json"), camera.to_string().as_bytes());
    }
}
