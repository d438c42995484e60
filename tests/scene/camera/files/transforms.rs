//! Cameras of D-NeRF, Blender and nerfstudio: poses, times and lenses, and what is refused by field.

use std::fs;
use std::path::Path;

use glam::{Mat4, Vec2, Vec3};
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::{Camera, CameraSet, FrameSize, View};
use proptest::prelude::*;
use serde_json::{Value, json};

use super::super::{POSE_TOLERANCE, assert_near, size};
use super::parse;
use crate::scene::assert_refused;
use crate::support::shared;

/// An upright OpenGL camera at (0, -4, 0) that looks along +y, as Blender exports it.
fn blender_pose() -> Value {
    json!([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1.0, -4.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
}

fn transforms(frames: &[Value]) -> Value {
    json!({ "camera_angle_x": 0.6911112070083618, "frames": frames })
}

fn frame(time: f64) -> Value {
    json!({ "file_path": "./train/r_0", "time": time, "transform_matrix": blender_pose() })
}

#[test]
fn opengl_poses_become_opencv_ones() {
    let set = parse(&transforms(&[frame(0.0)])).expect("a D-NeRF file");
    let camera = set.views[0].camera;
    assert_near(camera.position(), Vec3::new(0.0, -4.0, 0.0), POSE_TOLERANCE);
    assert_eq!((camera.width, camera.height), (800, 800), "D-NeRF's size");
    // 800 / (2 tan(0.6911112070083618 / 2)) = 1111.111; f32 holds seven digits.
    assert!((camera.fx - 1111.111).abs() < 1e-3 && camera.fx == camera.fy, "{} {}", camera.fx, camera.fy);
    let (pixel, depth) = camera.project(Vec3::ZERO).expect("the origin is in front");
    assert_eq!((pixel, depth), (Vec2::splat(399.5), 4.0), "the axis lies between the middle pixels");
    let (right, _) = camera.project(Vec3::X).expect("in front");
    let (up, _) = camera.project(Vec3::Z).expect("in front");
    assert!(right.x > pixel.x && right.y == pixel.y, "world x is to the right: {right}");
    assert!(up.y < pixel.y && up.x == pixel.x, "world z is up: {up}");
    assert!(camera.project(Vec3::new(0.0, -5.0, 0.0)).is_none(), "behind the camera");
}

#[test]
fn times_above_one_are_scaled_and_frames_of_one_camera_are_grouped() {
    let mut other = frame(5.0);
    other["transform_matrix"][0][3] = json!(1.0);
    other["file_path"] = json!("second");
    let set = parse(&transforms(&[frame(0.0), frame(2.5), other, frame(10.0)])).expect("a D-NeRF file");
    assert_eq!(set.views.len(), 2);
    assert_eq!(set.views[0].times, [0.0, 0.25, 1.0]);
    assert_eq!((set.views[1].name.as_str(), set.views[1].times.as_slice()), ("second", &[0.5][..]));
    let entries: Vec<(usize, f32)> = set.entries().map(|(view, _, time)| (view, time)).collect();
    assert_eq!(entries, [(0, 0.0), (0, 0.25), (0, 1.0), (1, 0.5)]);
    let unscaled = parse(&transforms(&[frame(0.1), frame(0.9)])).expect("a D-NeRF file");
    assert_eq!(unscaled.views[0].times, [0.1, 0.9], "times within [0,1] stay");
}

/// 4DGaussians trains with frame time / largest time of training and test files, also below 1.
#[test]
fn times_of_a_dataset_are_scaled_by_its_training_and_test_files() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, times: &[f64]| {
        let frames: Vec<Value> = times.iter().map(|&time| frame(time)).collect();
        fs::write(folder.path().join(name), transforms(&frames).to_string()).expect("writable");
    };
    let times = |name: &str| {
        let set = CameraSet::open(&folder.path().join(name), FrameSize::DNERF).expect(name);
        set.views[0].times.clone()
    };
    let (train, test, val) = ("transforms_train.json", "transforms_test.json", "transforms_val.json");
    write(test, &[0.0, 0.3]);
    assert_eq!(times(test), [0.0, 0.3], "alone it may be the start of anything");
    write(train, &[0.0, 0.6]);
    write(val, &[0.15, 0.45]);
    write("mine.json", &[0.0, 0.3]);
    assert_eq!(times(test), [0.0, 0.5]);
    assert_eq!(times(train), [0.0, 1.0]);
    assert_eq!(times(val), [0.25, 0.75]);
    assert_eq!(times("mine.json"), [0.0, 0.3], "no file of the dataset");
    write(train, &[0.0, 80.0]);
    write(test, &[20.0, 160.0]);
    assert_eq!((times(train), times(test)), (vec![0.0, 0.5], vec![0.125, 1.0]), "frame numbers");
    write(train, &[0.0, 0.0]);
    write(test, &[0.0, 0.0]);
    assert_eq!(times(train), [0.0, 0.0], "one moment");
    fs::write(folder.path().join(test), "{\"frames\": 7}").expect("writable");
    match CameraSet::open(&folder.path().join(train), FrameSize::DNERF) {
        Err(EngineError::BadData { path, field, .. }) => {
            assert_eq!((path, field), (folder.path().join(test), "json".to_owned()))
        }
        other => panic!("the dataset's other file must be refused: {other:?}"),
    }
}

#[test]
fn files_without_times_leave_them_open() {
    let mut still = frame(0.0);
    still.as_object_mut().expect("an object").remove("time");
    let set = parse(&transforms(&[still.clone()])).expect("a static file");
    assert_eq!(set.entries().count(), 0, "no time is invented");
    let timed = set.at_times(&[0.0, 0.5]);
    assert_eq!(timed.entries().count(), 2);
    assert_refused(parse(&transforms(&[frame(0.0), still])), &["frames[1].time", "missing"]);
}

#[test]
fn nerfstudio_lenses_are_read() {
    let file = json!({ "fl_x": 500.0, "fl_y": 400.0, "cx": 160.0, "cy": 130.0, "w": 320, "h": 240, "k1": 0.0,
                       "frames": [{ "transform_matrix": blender_pose() }] });
    let camera = parse(&file).expect("a nerfstudio file").views[0].camera;
    assert_eq!((camera.fx, camera.fy, camera.width, camera.height), (500.0, 400.0, 320, 240));
    assert_eq!((camera.cx, camera.cy), (159.5, 129.5), "pixel centres instead of pixel edges");
    let mut distorted = file.clone();
    distorted["k2"] = json!(0.01);
    assert_refused(parse(&distorted), &["lens distortion", "0.01"]);
}

#[test]
fn malformed_files_are_refused_by_field() {
    let edit = |change: fn(&mut Value)| {
        let mut file = transforms(&[frame(0.0), frame(1.0)]);
        change(&mut file);
        parse(&file)
    };
    assert_refused(edit(|f| f["frames"] = json!([])), &["cameras", "none"]);
    assert_refused(edit(|f| f["frames"][1]["time"] = json!(-0.5)), &["frames[1].time", "-0.5"]);
    assert_refused(edit(|f| f["frames"][1]["time"] = json!("late")), &["json", "string"]);
    assert_refused(edit(|f| f["camera_angle_x"] = json!(4.0)), &["camera_angle_x", "4"]);
    assert_refused(edit(|f| f["camera_angle_x"] = Value::Null), &["focal length", "missing"]);
    assert_refused(edit(|f| f["fl_x"] = json!(-1.0)), &["focal length", "-1"]);
    assert_refused(edit(|f| f["w"] = json!(0)), &["image size", "0x800"]);
    assert_refused(edit(|f| f["h"] = json!(100_000)), &["image size", "800x100000"]);
    let matrix = |f: &mut Value, row: usize, column: usize, value: f64| {
        f["frames"][1]["transform_matrix"][row][column] = json!(value);
    };
    let edit_matrix = |row, column, value| {
        let mut file = transforms(&[frame(0.0), frame(1.0)]);
        matrix(&mut file, row, column, value);
        parse(&file)
    };
    assert_refused(edit_matrix(0, 0, 2.0), &["frames[1].transform_matrix", "a rotation"]);
    assert_refused(edit_matrix(0, 0, -1.0), &["frames[1].transform_matrix", "a rotation"]);
    assert_refused(edit_matrix(0, 3, 1e300), &["frames[1].transform_matrix", "a finite position"]);
    assert_refused(edit_matrix(3, 0, 0.5), &["frames[1].transform_matrix", "last row"]);
    assert_refused(parse(&json!({})), &["another kind of file"]);
    assert_refused(parse(&json!(7)), &["another kind of file"]);
    assert_refused(parse(&json!([{}])), &["img_name"]);
    let text = CameraSet::parse(Path::new("x"), b"{", FrameSize::DNERF);
    assert_refused(text, &["json", "line 1"]);
}

#[test]
fn the_golden_camera_is_read() {
    let Some(path) = shared("data/golden/raster_fruit/camera.json") else { return };
    let Some(expected) = shared("data/golden/raster_fruit/expected.safetensors") else { return };
    let camera = CameraSet::open(&path, FrameSize::DNERF).expect("the golden camera").views[0].camera;
    assert_eq!((camera.width, camera.height), (176, 132));
    assert_eq!((camera.cx, camera.cy), (87.5, 65.5));
    // tan(0.45), from fov_x_radians = 0.9 in the file; one rounding to f32.
    assert!((camera.tan_fovx() - 0.483_055_1).abs() < 1e-6, "{}", camera.tan_fovx());
    assert!((camera.tan_fovy() - 0.483_055_1 * 132.0 / 176.0).abs() < 1e-6, "{}", camera.tan_fovy());
    let bytes = fs::read(expected).expect("the file can be read");
    let tensors = safetensors::SafeTensors::deserialize(&bytes).expect("a safetensors file");
    let floats = |name: &str| -> Vec<f32> {
        let tensor = tensors.tensor(name).expect(name);
        tensor.data().as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
    };
    let rows: [f32; 16] = floats("world_to_camera").try_into().expect("a 4x4 matrix");
    assert_eq!(camera.world_to_camera, Mat4::from_cols_array(&rows).transpose());
    assert_near(camera.position(), Vec3::from_slice(&floats("camera_position")), POSE_TOLERANCE);
}

#[test]
fn real_files_are_read() {
    for (file, views, entries) in [
        ("dnerf/lego_transforms_train.json", 50, 50),
        ("dnerf/fox/transforms_train.json", 100, 100),
        ("dnerf/fox/transforms_test.json", 20, 20),
        ("models/robot/transforms_test.json", 48, 48),
    ] {
        let Some(path) = shared(&format!("data/{file}")) else { return };
        let set = CameraSet::open(&path, size(400, 400)).expect(file);
        assert_eq!((set.views.len(), set.entries().count()), (views, entries), "{file}");
        for (_, camera, time) in set.entries() {
            assert!((0.0..=1.0).contains(&time), "{file}: {time}");
            let (centre, _) = camera.project(Vec3::ZERO).expect("the origin is in front");
            // All these cameras aim at the origin; 4-digit poses at focal 556 px move it by less than 0.1 px.
            assert!((centre - Vec2::splat(199.5)).abs().max_element() < 0.1, "{file}: {centre}");
        }
    }
}

#[test]
fn frames_may_have_lenses_of_their_own() {
    let pose = json!([[1, 0, 0, 0], [0, 0, -1, -4], [0, 1, 0, 0], [0, 0, 0, 1]]);
    let file = json!({ "camera_model": "OPENCV", "camera_angle_x": 0.7, "fl_x": 50, "fl_y": 60,
                       "cx": 10, "w": 20.0, "h": 30,
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
    fn random_bytes_never_panic(bytes: Vec<u8>) {
        prop_assert!(CameraSet::parse(Path::new("x"), &bytes, FrameSize::DNERF).is_err());
    }

    #[test]
    fn random_numbers_never_panic(values: [f64; 16], angle: f64, time: f64) {
        let rows: Vec<&[f64]> = values.chunks(4).collect();
        let file = json!({ "camera_angle_x": angle, "frames": [{ "time": time, "transform_matrix": rows }] });
        drop(parse(&file));
    }
}

#[test]
fn a_films_cameras_come_back_in_its_order() {
    let pose =
        |x: f32| Mat4::from_rotation_x(0.3) * Mat4::from_rotation_z(x) * Mat4::from_translation(Vec3::new(x, 4.0, 1.0));
    let camera = |x: f32, width: u32| Camera {
        world_to_camera: pose(x),
        fx: 410.5,
        fy: 398.25,
        cx: 201.125,
        cy: 140.75,
        width,
        height: 300,
    };
    // The first camera comes again behind others: grouped by camera, the film would have another order.
    let shots =
        [(camera(0.1, 400), 0.0f32), (camera(0.7, 400), 1.0 / 3.0), (camera(0.1, 400), 0.9), (camera(0.1, 320), 0.2)];
    let views = shots.map(|(camera, time)| View { name: String::new(), camera, times: vec![time], located: true });
    let film = CameraSet { views: views.to_vec(), in_sequence: true };
    let back = CameraSet::parse(Path::new("film.json"), &film.film_json(), size(8, 8)).expect("transforms");
    let clips = back.clips();
    assert_eq!(clips.len(), 1, "one film");
    assert_eq!(clips[0].len(), shots.len());
    for ((camera, time), (again, time_again)) in shots.iter().zip(&clips[0]) {
        assert_eq!(time, time_again);
        let lens = |c: &Camera| (c.fx, c.fy, c.cx, c.cy, c.width, c.height);
        assert_eq!(lens(camera), lens(again));
        for point in [Vec3::ZERO, Vec3::ONE, Vec3::new(-0.5, 0.2, 0.9)] {
            let pixel = |c: &Camera| c.project(point).expect("in front").0;
            // f32 holds a hundred thousandth of a pixel at four hundred.
            assert_near(pixel(camera).extend(0.0), pixel(again).extend(0.0), 1e-3);
        }
    }
}
