//! Cameras of COLMAP, Nerfies and nerfstudio: what is read of them, and what is refused by file and field.

use std::fs;
use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use guard4d_engine::EngineError;
use guard4d_engine::scene::{Camera, CameraSet, ImageSize};
use proptest::prelude::*;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::camera_writers::{Format, Shot, colmap_binary, put};
use super::{assert_refused, bad_data};

/// Positions and matrices are f32 values near 4, inverted in f64: a few units in the last place.
const POSE_TOLERANCE: f32 = 2e-6;

fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder can be made")
}

fn open(path: &Path) -> Result<CameraSet, EngineError> {
    CameraSet::open(path, ImageSize::DNERF)
}

fn parse(value: &Value) -> Result<CameraSet, EngineError> {
    CameraSet::parse(Path::new("cameras.json"), value.to_string().as_bytes(), ImageSize::DNERF)
}

/// Three cameras with lenses of their own.
fn shots() -> [Shot; 3] {
    let shot = |x: f64, focal: f64| Shot {
        focal: [focal, focal + 5.0],
        principal: [30.0, 25.0],
        ..Shot::looking(DVec3::new(x, -4.0, 1.0), DVec3::ZERO, focal, [64, 48])
    };
    [shot(0.0, 60.0), shot(1.0, 70.0), shot(2.0, 80.0)]
}

/// Asserts where a camera stands, where it looks, and its lens.
#[track_caller]
fn assert_is(camera: &Camera, shot: &Shot) {
    let position = shot.position.as_vec3();
    assert!((camera.position() - position).abs().max_element() <= POSE_TOLERANCE, "{}", camera.position());
    for (axis, want) in [(Vec3::X, shot.axes.x_axis), (Vec3::Y, shot.axes.y_axis), (Vec3::Z, shot.axes.z_axis)] {
        let got = camera.world_to_camera.transpose().transform_vector3(axis);
        assert!((got - want.as_vec3()).abs().max_element() <= POSE_TOLERANCE, "{got} is not {want}");
    }
    // Some formats keep a ratio of both focal lengths; one unit in the last place at 80 is 8e-6.
    let [fx, fy] = shot.focal.map(|focal| focal as f32);
    assert!((camera.fx - fx).abs() <= 8e-6 && (camera.fy - fy).abs() <= 8e-6, "{} {}", camera.fx, camera.fy);
    let [cx, cy] = shot.principal.map(|edge| edge as f32 - 0.5);
    assert_eq!((camera.cx, camera.cy), (cx, cy), "pixel centres instead of pixel edges");
    assert_eq!([camera.width, camera.height], shot.size, "image size");
}

#[test]
fn folders_give_every_camera_with_its_own_lens() {
    let folder = folder();
    for (format, names) in [
        (Format::ColmapText, ["000.png", "001.png", "002.png"]),
        (Format::ColmapBinary, ["000.png", "001.png", "002.png"]),
        (Format::Nerfies, ["000000", "000001", "000002"]),
        (Format::NerfstudioFrames, ["images/000", "images/001", "images/002"]),
    ] {
        let set = open(&format.write(folder.path(), &shots())).unwrap_or_else(|e| panic!("{format:?}: {e}"));
        assert_eq!(set.views.iter().map(|view| view.name.as_str()).collect::<Vec<_>>(), names, "{format:?}");
        for (view, shot) in set.views.iter().zip(shots()) {
            assert_is(&view.camera, &shot);
        }
        let times: Vec<&[f32]> = set.views.iter().map(|view| view.times.as_slice()).collect();
        match format {
            Format::Nerfies => assert_eq!(times, [[0.0], [0.5], [1.0]], "warp_id / max(warp_id)"),
            _ => assert!(times.iter().all(|times| times.is_empty()), "{format:?} has no times"),
        }
    }
}

/// Poses by hand, so that writer and reader cannot be wrong alike.
#[test]
fn colmap_text_is_read_as_it_is_documented() {
    let folder = folder();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let cameras = "# comment\n\n7 SIMPLE_PINHOLE 320 240 250 160 120\n9 PINHOLE 100 80 90 95 49.5 40.25\n\
                   3 SIMPLE_RADIAL 10 10 5 5 5 0\n4 RADIAL 10 10 5 5 5 0 0\n5 FOV 10 10 5 5 5 5 0\n\
                   6 FULL_OPENCV 10 10 5 5 5 5 0 0 0 0 0 0 0 0\n";
    // Turned by +90 degrees about x: y of the world is z of the camera, z of the world is -y of it.
    let images = format!(
        "# comment\n2 {half} {half} 0 0 1 2 3 9 b with spaces.png\n0.5 0.5 -1 1.5 1.5 4\n\
         1 1 0 0 0 0 0 0 7 a.png\n\n   \n# comment\n3 -1 0 0 0 0 0 5 7 c.png"
    );
    put(folder.path(), "cameras.txt", cameras.as_bytes());
    put(folder.path(), "images.txt", images.as_bytes());
    let set = open(folder.path()).expect("a reconstruction");
    assert!(!set.in_sequence, "photos are no film");
    let names: Vec<&str> = set.views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["a.png", "b with spaces.png", "c.png"], "in the order of their names");
    let [a, b, c] = [0, 1, 2].map(|i: usize| set.views[i].camera);
    assert_eq!(a.world_to_camera, glam::Mat4::IDENTITY);
    assert_eq!((a.fx, a.fy, a.cx, a.cy, a.width, a.height), (250.0, 250.0, 159.5, 119.5, 320, 240));
    assert_eq!((b.fx, b.fy, b.cx, b.cy, b.width, b.height), (90.0, 95.0, 49.0, 39.75, 100, 80));
    let seen = b.world_to_camera.transform_point3(Vec3::new(10.0, 20.0, 30.0));
    // Numbers up to 30 pass through a rotation in f32.
    assert!(seen.distance(Vec3::new(11.0, -28.0, 23.0)) < 1e-5, "{seen}");
    assert_eq!(c.position(), Vec3::new(0.0, 0.0, -5.0), "-q turns as q does");
    assert_eq!(set.entries().count(), 0, "no time is invented");
}

#[test]
fn reconstructions_are_found_where_colmap_keeps_them() {
    let (binary, text) = (folder(), folder());
    Format::ColmapBinary.write(binary.path(), &shots());
    Format::ColmapText.write(text.path(), &shots()[..1]);
    let root = folder();
    let copy = |from: PathBuf, to: &str| {
        let to = root.path().join(to);
        fs::create_dir_all(&to).expect("writable");
        for file in fs::read_dir(from).expect("a folder").map(|file| file.expect("a file")) {
            fs::copy(file.path(), to.join(file.file_name())).expect("writable");
        }
    };
    let views = || open(root.path()).expect("a reconstruction").views.len();
    assert_refused(open(root.path()), &["folder", "no cameras", "sparse/0", "dataset.json"]);
    copy(binary.path().join("binary/sparse/0"), "sparse");
    assert_eq!(views(), 3);
    copy(text.path().join("text"), "sparse");
    assert_eq!(views(), 3, "binary before text");
    copy(text.path().join("text"), "sparse/0");
    assert_eq!(views(), 1, "the first model of a data set");
    copy(binary.path().join("binary/sparse/0"), "");
    assert_eq!(views(), 3, "the folder itself");
    fs::remove_file(root.path().join("images.bin")).expect("there");
    assert_eq!(views(), 1, "whole pairs first");
    let missing = |folder: &Path, word: &str| {
        let error = open(folder).expect_err("a file is missing");
        assert_eq!(error.exit_code(), 66, "{error}");
        assert!(error.to_string().contains(word), "`{word}` is not in `{error}`");
    };
    let alone = folder();
    put(alone.path(), "cameras.txt", b"");
    missing(alone.path(), "images.txt");
    missing(&alone.path().join("nowhere"), "nowhere");
}

fn colmap_with(cameras: &str, images: &str) -> Result<CameraSet, EngineError> {
    let folder = folder();
    put(folder.path(), "cameras.txt", cameras.as_bytes());
    put(folder.path(), "images.txt", images.as_bytes());
    open(folder.path())
}

#[test]
fn malformed_colmap_text_is_refused_by_line() {
    let camera = "1 PINHOLE 64 48 60 60 32 24\n";
    let image = "5 1 0 0 0 0 0 0 1 a.png\n\n";
    assert_eq!(colmap_with(camera, image).expect("a reconstruction").views.len(), 1);
    let cameras = |text: &str, words: &[&str]| assert_refused(colmap_with(text, image), words);
    cameras("1 PINHOLE 64 48 60 60 32\n", &["line 1: number of parameters", "`3`", "4 for PINHOLE"]);
    cameras("\n1 PINBALL 64 48 60\n", &["line 2: model", "`PINBALL`", "SIMPLE_RADIAL"]);
    cameras("x PINHOLE 64 48 60 60 32 24", &["line 1: camera number", "`x`", "a whole number"]);
    cameras("1 PINHOLE -64 48 60 60 32 24", &["line 1: width", "`-64`"]);
    cameras("1 PINHOLE 64", &["line 1: height", "``"]);
    cameras("1 PINHOLE 64 48 NaN 60 32 24", &["line 1: parameter", "`NaN`", "a finite number"]);
    cameras("1 PINHOLE 64 48 0 60 32 24", &["camera 1: focal length", "positive"]);
    cameras("1 PINHOLE 64 48 60 60 1e300 24", &["camera 1: principal point", "a finite number"]);
    cameras("1 PINHOLE 64 99999999999 60 60 32 24", &["camera 1: image size", "64x99999999999"]);
    cameras("1 OPENCV 64 48 60 60 32 24 0 0.01 0 0", &["camera 1: lens distortion", "0.01", "image_undistorter"]);
    cameras("1 OPENCV_FISHEYE 64 48 60 60 32 24 0 0 0 0", &["camera 1: model", "OPENCV_FISHEYE"]);
    cameras(&camera.repeat(2), &["camera 1", "there twice"]);
    cameras("# nothing\n", &["image 5: camera", "1", "a camera of the cameras file"]);
    let images = |text: &str, words: &[&str]| assert_refused(colmap_with(camera, text), words);
    images("# nothing\n", &["cameras", "none"]);
    images("5 1 0 0 0 0 0 0 2 a.png\n\n", &["image 5: camera", "2"]);
    images("5 1 0 0 0 0 0 0 1\n\n", &["line 1: name", "0 bytes"]);
    images(&format!("5 1 0 0 0 0 0 0 1 {}\n\n", "a".repeat(4097)), &["line 1: name", "4097 bytes"]);
    images("5 1 0 0 0 0 0 inf 1 a.png\n\n", &["line 1: pose", "`inf`"]);
    images("5 1 0 0\n", &["line 1: pose", "``"]);
    images("5 0.9 0 0 0 0 0 0 1 a.png\n\n", &["image 5: rotation", "0.9", "length 1"]);
    images("5 0 0 0 0 0 0 0 1 a.png\n\n", &["image 5: rotation", "length 1"]);
    images("5 1 0 0 0 1e300 0 0 1 a.png\n\n", &["image 5: pose", "a finite position"]);
    let unpaired = "5 1 0 0 0 0 0 0 1 a.png\n6 1 0 0 0 0 0 0 1 b.png\n";
    images(unpaired, &["line 2: points of an image", "b.png", "an empty line"]);
    let folder = folder();
    put(folder.path(), "cameras.txt", camera.as_bytes());
    put(folder.path(), "images.txt", b"\xff\xfe");
    assert_refused(open(folder.path()), &["text", "UTF-8"]);
}

fn binary(cameras: &[u8], images: &[u8]) -> Result<CameraSet, EngineError> {
    let folder = folder();
    put(folder.path(), "cameras.bin", cameras);
    put(folder.path(), "images.bin", images);
    open(folder.path())
}

#[test]
fn malformed_colmap_binaries_are_refused_by_field() {
    let (cameras, images) = colmap_binary(&shots());
    assert_eq!(binary(&cameras, &images).expect("a reconstruction").views.len(), 3);
    for end in 0..cameras.len() {
        bad_data(binary(&cameras[..end], &images));
    }
    for end in 0..images.len() {
        bad_data(binary(&cameras, &images[..end]));
    }
    assert_refused(binary(&cameras[..7], &images), &["number of cameras", "7 bytes are left", "8 bytes"]);
    assert_refused(binary(&cameras[..cameras.len() - 1], &images), &["camera 3: parameters", "7 bytes are left"]);
    assert_refused(binary(&cameras, &[&images[..], &[0]].concat()), &["end of the images", "1 bytes more"]);
    // Behind the count: number 0, model 4, width 8, height 16, parameters 24.
    let camera = |at: usize, bytes: &[u8]| {
        let mut file = cameras.clone();
        file[8 + at..][..bytes.len()].copy_from_slice(bytes);
        binary(&file, &images)
    };
    assert_refused(camera(4, &77_i32.to_le_bytes()), &["camera 1: model", "77", "0 to 11"]);
    assert_refused(camera(4, &(-1_i32).to_le_bytes()), &["camera 1: model", "-1"]);
    assert_refused(camera(8, &u64::MAX.to_le_bytes()), &["camera 1: image size", "18446744073709551615x48"]);
    assert_refused(camera(24, &f64::NAN.to_le_bytes()), &["camera 1: parameters", "NaN"]);
    assert_refused(camera(0, &2_u32.to_le_bytes()), &["camera 2", "there twice"]);
    let mut many = cameras.clone();
    many[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    assert_refused(binary(&many, &images), &["number of cameras", "18446744073709551615", "at most 3"]);
    // Behind the count: number 0, rotation 4, translation 36, camera 60, name 64, points 72.
    let image = |at: usize, bytes: &[u8]| {
        let mut file = images.clone();
        file[8 + at..][..bytes.len()].copy_from_slice(bytes);
        binary(&cameras, &file)
    };
    assert_refused(image(4, &3.0_f64.to_le_bytes()), &["image 11: rotation", "length 1"]);
    assert_refused(image(4, &f64::INFINITY.to_le_bytes()), &["image 11: pose", "inf"]);
    assert_refused(image(36, &1e300_f64.to_le_bytes()), &["image 11: pose", "a finite position"]);
    assert_refused(image(60, &9_u32.to_le_bytes()), &["image 11: camera", "9"]);
    assert_refused(image(72, &(u64::MAX / 24 + 2).to_le_bytes()), &["image 11: number of points", "the file has room"]);
    let mut many = images.clone();
    many[..8].copy_from_slice(&(1_u64 << 40).to_le_bytes());
    assert_refused(binary(&cameras, &many), &["number of images", "1099511627776", "at most"]);
    let endless = [&images[..72], &[b'a'; 5000]].concat();
    assert_refused(binary(&cameras, &endless), &["image 11: name", "no end", "4096 bytes"]);
}

/// A Nerfies folder of three images after a change to one of its files.
fn nerfies_with(file: &str, change: impl FnOnce(&mut Value)) -> Result<CameraSet, EngineError> {
    let folder = folder();
    let root = Format::Nerfies.write(folder.path(), &shots());
    let text = fs::read(root.join(file)).expect("written a moment ago");
    let mut value = serde_json::from_slice(&text).expect("JSON");
    change(&mut value);
    put(&root, file, value.to_string().as_bytes());
    open(&root)
}

#[test]
fn nerfies_folders_are_read_as_4dgaussians_does() {
    let camera = "camera/000001.json";
    let set = nerfies_with("metadata.json", |m| m["000001"]["warp_id"] = json!(8)).expect("a data set");
    let times: Vec<f32> = set.entries().map(|(_, _, time)| time).collect();
    assert_eq!(times, [0.0, 1.0, 0.25], "by the largest of all images");
    let still = nerfies_with("metadata.json", |m| {
        for id in ["000000", "000001", "000002"] {
            m[id]["warp_id"] = json!(0);
        }
    });
    assert!(still.expect("a data set").entries().all(|(_, _, time)| time == 0.0), "one moment is time 0");
    let distorted = nerfies_with(camera, |c| c["radial_distortion"] = json!([0.1, -0.2, 0.0])).expect("a data set");
    assert_is(&distorted.views[1].camera, &shots()[1]);
    let bare = nerfies_with(camera, |c| {
        for field in ["radial_distortion", "tangential_distortion", "skew", "pixel_aspect_ratio", "principal_point"] {
            c.as_object_mut().expect("an object").remove(field);
        }
    });
    let bare = bare.expect("a data set").views[1].camera;
    assert_eq!((bare.fx, bare.fy, bare.cx, bare.cy), (70.0, 70.0, 31.5, 23.5), "square pixels, axis in the middle");
    let fixed = nerfies_with("dataset.json", |d| d["ids"] = json!(["000002", "000000"])).expect("a data set");
    assert_eq!(fixed.views[0].name, "000002", "in the order of dataset.json");
    assert_eq!((fixed.views[0].times[0], fixed.views[1].times[0]), (1.0, 0.0));
}

#[test]
fn malformed_nerfies_folders_are_refused_by_file_and_field() {
    let camera = |change: fn(&mut Value)| nerfies_with("camera/000001.json", change);
    assert_refused(camera(|c| c["orientation"][0][0] = json!(3.0)), &["orientation and position", "a rotation"]);
    assert_refused(camera(|c| c["position"] = json!([1, 2])), &["json", "the camera of an image"]);
    assert_refused(camera(|c| c["focal_length"] = json!(-2)), &["focal length", "-2", "positive"]);
    assert_refused(camera(|c| c["pixel_aspect_ratio"] = json!(0)), &["focal length", "positive"]);
    assert_refused(camera(|c| c["image_size"] = json!([0, 5])), &["image size", "0x5"]);
    assert_refused(camera(|c| c["skew"] = json!(0.5)), &["skew", "0.5"]);
    let index = |ids: Value| nerfies_with("dataset.json", |d| d["ids"] = ids);
    assert_refused(index(json!([])), &["cameras", "none"]);
    assert_refused(index(json!(["../000001"])), &["ids[0]", "../000001", "without folders"]);
    assert_refused(index(json!(["000000", ""])), &["ids[1]"]);
    assert_refused(index(json!(["000000", 7])), &["json", "list of images"]);
    assert_refused(index(json!(["000000", "000009"])), &["000009", "missing", "warp_id"]);
    assert_refused(nerfies_with("metadata.json", |m| m["000001"] = json!({})), &["json", "warp_id"]);
    let folder = folder();
    let root = Format::Nerfies.write(folder.path(), &shots());
    for file in ["camera/000002.json", "metadata.json"] {
        fs::remove_file(root.join(file)).expect("written a moment ago");
        let error = open(&root).expect_err("a file is missing");
        assert_eq!(error.exit_code(), 66, "{error}");
        assert!(error.to_string().contains(file), "{error}");
    }
}

fn path_file() -> Value {
    let stop = |x: f64| json!({ "camera_to_world": [1, 0, 0, x, 0, 0, -1, -4, 0, 1, 0, 0, 0, 0, 0, 1], "fov": 60.0, "aspect": 2 });
    json!({ "camera_type": "perspective", "render_width": 200, "render_height": 100,
            "camera_path": [stop(0.0), stop(1.0), stop(2.0), stop(2.0), stop(3.0)] })
}

#[test]
fn nerfstudio_paths_are_films() {
    let set = parse(&path_file()).expect("a path");
    assert!(set.in_sequence, "frames of one film, also where the camera rests");
    let times: Vec<f32> = set.entries().map(|(_, _, time)| time).collect();
    assert_eq!(times, [0.0, 0.25, 0.5, 0.75, 1.0], "from start to end");
    let camera = set.views[1].camera;
    // 100 / 2 / tan(30 degrees): the field of view is the vertical one.
    assert!((camera.fx - 86.602_54).abs() < 1e-5 && camera.fy == camera.fx, "{} {}", camera.fx, camera.fy);
    assert_eq!((camera.cx, camera.cy, camera.width, camera.height), (99.5, 49.5, 200, 100));
    assert!(camera.position().distance(Vec3::new(1.0, -4.0, 0.0)) <= POSE_TOLERANCE, "{}", camera.position());
    let (pixel, depth) = camera.project(Vec3::new(1.0, 0.0, 1.0)).expect("in front");
    assert!((depth - 4.0).abs() <= POSE_TOLERANCE && pixel.y < 49.5, "looks along +y, z up: {pixel} {depth}");
    let mut timed = path_file();
    for (stop, time) in timed["camera_path"].as_array_mut().expect("a list").iter_mut().zip([1.0, 0.5, 0.5, 0.5, 0.0]) {
        stop["render_time"] = json!(time);
    }
    let clips = parse(&timed).expect("a path").clips();
    assert_eq!(clips.len(), 1, "one film");
    assert_eq!(clips[0].iter().map(|(_, time)| *time).collect::<Vec<_>>(), [1.0, 0.5, 0.5, 0.5, 0.0], "as filmed");
    timed["render_width"].take();
    timed["render_height"].take();
    timed.as_object_mut().expect("an object").remove("camera_type");
    let camera = parse(&timed).expect("a path").views[0].camera;
    assert_eq!((camera.width, camera.height), (800, 800), "the size that was asked for");
}

#[test]
fn malformed_paths_are_refused_by_field() {
    let edit = |change: fn(&mut Value)| {
        let mut file = path_file();
        change(&mut file);
        parse(&file)
    };
    assert_refused(edit(|f| f["camera_type"] = json!("fisheye")), &["camera_type", "fisheye", "perspective"]);
    assert_refused(edit(|f| f["camera_path"] = json!([])), &["cameras", "none"]);
    assert_refused(edit(|f| f["camera_path"][1]["fov"] = json!(180)), &["camera_path[1].fov", "180"]);
    assert_refused(edit(|f| f["camera_path"][1]["fov"] = json!(0)), &["camera_path[1].fov", "0"]);
    assert_refused(
        edit(|f| f["camera_path"][2]["camera_to_world"][12] = json!(1)),
        &["[2].camera_to_world", "last row"],
    );
    assert_refused(
        edit(|f| f["camera_path"][2]["camera_to_world"][0] = json!(2)),
        &["[2].camera_to_world", "a rotation"],
    );
    assert_refused(edit(|f| f["camera_path"][0]["camera_to_world"] = json!([1, 2])), &["json", "16"]);
    assert_refused(edit(|f| f["camera_path"][0]["render_time"] = json!(1)), &["camera_path[1].render_time", "missing"]);
    assert_refused(edit(|f| f["render_width"] = json!(0)), &["render image size", "0x100"]);
}

#[test]
fn frames_may_have_lenses_of_their_own() {
    let pose = json!([[1, 0, 0, 0], [0, 0, -1, -4], [0, 1, 0, 0], [0, 0, 0, 1]]);
    let file = json!({ "camera_model": "OPENCV", "camera_angle_x": 0.7, "fl_x": 50, "fl_y": 60, "cx": 10, "w": 20.0, "h": 30,
                       "frames": [{ "transform_matrix": pose }, { "transform_matrix": pose, "fl_x": 70, "cy": 14 },
                                  { "transform_matrix": pose, "camera_angle_x": 1.0, "w": 40 }] });
    let views = parse(&file).expect("a nerfstudio file").views;
    let lens = |i: usize| {
        let c: Camera = views[i].camera;
        (c.fx, c.fy, c.cx, c.cy, c.width, c.height)
    };
    assert_eq!(views.len(), 3, "one place, three lenses");
    assert_eq!(lens(0), (50.0, 60.0, 9.5, 14.5, 20, 30));
    assert_eq!(lens(1), (70.0, 70.0, 9.5, 13.5, 20, 30));
    // 40 / (2 tan(0.5)), rounded once.
    let focal = (20.0 / 0.5_f64.tan()) as f32;
    assert_eq!(lens(2), (focal, focal, 9.5, 14.5, 40, 30));
    let edit = |change: fn(&mut Value)| {
        let mut file = file.clone();
        change(&mut file);
        parse(&file)
    };
    assert_refused(edit(|f| f["frames"][1]["k1"] = json!(0.2)), &["frames[1].lens distortion", "0.2"]);
    assert_refused(edit(|f| f["frames"][1]["fl_x"] = json!(0)), &["frames[1].focal length", "positive"]);
    assert_refused(edit(|f| f["frames"][2]["h"] = json!(0)), &["frames[2].image size", "40x0"]);
    assert_refused(edit(|f| f["w"] = json!(20.5)), &["image size", "20.5", "a whole number"]);
    assert_refused(
        edit(|f| f["camera_model"] = json!("EQUIRECTANGULAR")),
        &["camera_model", "EQUIRECTANGULAR", "PINHOLE"],
    );
    assert_refused(edit(|f| f["is_fisheye"] = json!(true)), &["is_fisheye", "true"]);
    assert_refused(edit(|f| f["cx"] = json!(1e300)), &["principal point", "a finite number"]);
}

proptest! {
    #[test]
    fn random_binaries_never_panic(cameras: Vec<u8>, images: Vec<u8>) {
        prop_assert!(binary(&cameras, &images).is_err());
    }

    /// A few bytes of a good file are replaced, so that what follows its header is reached.
    #[test]
    fn damaged_binaries_never_panic(edits in prop::collection::vec((any::<bool>(), any::<prop::sample::Index>(), any::<u8>()), 1..8)) {
        let (mut cameras, mut images) = colmap_binary(&shots());
        for (in_images, at, byte) in edits {
            let file = if in_images { &mut images } else { &mut cameras };
            let at = at.index(file.len());
            file[at] = byte;
        }
        if let Ok(set) = binary(&cameras, &images) {
            prop_assert!(set.views.iter().all(|view| view.camera.world_to_camera.is_finite()), "poses are finite");
        }
    }

    #[test]
    fn random_text_never_panics(cameras: String, images: String) {
        drop(colmap_with(&cameras, &images));
    }
}
