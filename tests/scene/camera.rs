//! Cameras: files of several programs, projection, and cameras made by rule.

use std::fs;
use std::path::Path;

use glam::{Mat4, Vec2, Vec3};
use guard4d_engine::EngineError;
use guard4d_engine::scene::camera_paths::{Band, Lens, Orbit};
use guard4d_engine::scene::{Camera, CameraSet, Gaussians, ImageSize};
use proptest::prelude::*;
use serde_json::{Value, json};

use super::assert_refused;
use crate::support::shared;

/// Positions and matrices are f32 values near 4, inverted in f64: a few units in the last place.
const POSE_TOLERANCE: f32 = 2e-6;

fn parse(value: &Value) -> Result<CameraSet, EngineError> {
    CameraSet::parse(Path::new("cameras.json"), value.to_string().as_bytes(), ImageSize::DNERF)
}

fn size(width: u32, height: u32) -> ImageSize {
    ImageSize::new(width, height).expect("a small size")
}

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

fn lens() -> Lens {
    Lens { fov_x_rad: 0.69, size: size(64, 48) }
}

fn orbit(views: u32) -> Orbit {
    Orbit { views, elevation_deg: 30.0, radius: 4.0, target: Vec3::ZERO, lens: lens() }
}

fn band() -> Band {
    Band {
        azimuth_deg: -180.0..=180.0,
        elevation_deg: 10.0..=60.0,
        radius: 3.0..=5.0,
        target: Vec3::new(0.5, -0.25, 1.0),
        lens: lens(),
    }
}

fn assert_near(got: Vec3, want: Vec3, tolerance: f32) {
    assert!((got - want).abs().max_element() <= tolerance, "{got} is not {want}");
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
        let set = CameraSet::open(&folder.path().join(name), ImageSize::DNERF).expect(name);
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
    match CameraSet::open(&folder.path().join(train), ImageSize::DNERF) {
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
    let text = CameraSet::parse(Path::new("x"), b"{", ImageSize::DNERF);
    assert_refused(text, &["json", "line 1"]);
}

#[test]
fn the_golden_camera_is_read() {
    let Some(path) = shared("data/golden/raster_fruit/camera.json") else { return };
    let Some(expected) = shared("data/golden/raster_fruit/expected.safetensors") else { return };
    let camera = CameraSet::open(&path, ImageSize::DNERF).expect("the golden camera").views[0].camera;
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
fn inria_and_dnerf_files_of_one_kind_agree_on_axes() {
    let Some(path) = shared("data/pth/deformable_standup_run256/cameras.json") else { return };
    let set = CameraSet::open(&path, ImageSize::DNERF).expect("an INRIA file");
    assert_eq!(set.views.len(), 170);
    for view in &set.views {
        let camera = &view.camera;
        assert!((camera.fx - 1111.111).abs() < 1e-3, "{}: {}", view.name, camera.fx);
        let (centre, depth) = camera.project(Vec3::ZERO).expect("the origin is in front");
        // D-NeRF cameras aim at the origin from radius 4.03 (formats: t.x, t.y below 2e-7); 1e-3 px of rounding.
        assert!((centre - Vec2::splat(399.5)).abs().max_element() < 1e-2, "{}: {centre}", view.name);
        assert!((depth - 4.031).abs() < 1e-2, "{}: {depth}", view.name);
    }
}

#[test]
fn the_orbit_stands_where_blender_and_the_shipped_cameras_do() {
    let set = orbit(6).cameras().expect("a good orbit");
    assert_eq!(set.views.len(), 6);
    let first = set.views[0].camera;
    assert_near(first.position(), Vec3::new(0.0, -12.0_f32.sqrt(), 2.0), POSE_TOLERANCE);
    let Some(path) = shared("data/models/robot/transforms_test.json") else { return };
    let shipped = CameraSet::open(&path, lens().size).expect("shipped cameras");
    let difference = first.world_to_camera - shipped.views[0].camera.world_to_camera;
    let worst = difference.to_cols_array().into_iter().fold(0.0, |worst: f32, e| worst.max(e.abs()));
    assert!(worst <= POSE_TOLERANCE && difference.is_finite(), "{difference}");
}

#[test]
fn orbits_keep_radius_horizon_and_spacing() {
    let target = Vec3::new(1.0, 2.0, 3.0);
    let set = Orbit { target, ..orbit(8) }.cameras().expect("a good orbit");
    for (index, view) in set.views.iter().enumerate() {
        let (pixel, depth) = view.camera.project(target).expect("the target is in front");
        // The target projects through f32 matrices at focal 89 px: rounding stays below 1e-3 px.
        assert!((pixel - Vec2::new(31.5, 23.5)).abs().max_element() < 1e-3, "{pixel}");
        assert!((depth - 4.0).abs() < 1e-5, "{depth}");
        let (above, _) = view.camera.project(target + Vec3::Z * 0.1).expect("in front");
        assert!((above.x - pixel.x).abs() < 1e-3 && above.y < pixel.y, "upright: {above}");
        let azimuth = (index as f32 * 45.0).to_radians();
        let side = view.camera.position() - target;
        let radius = 12.0_f32.sqrt();
        assert_near(side, Vec3::new(radius * azimuth.sin(), -radius * azimuth.cos(), 2.0), 1e-5);
    }
    for elevation_deg in [90.0, -90.0] {
        let pole = Orbit { elevation_deg, ..orbit(1) }.cameras().expect("straight above and below").views[0].camera;
        assert!(pole.world_to_camera.is_finite(), "the pole has a camera");
        assert!((pole.world_to_camera.determinant() - 1.0).abs() < 1e-6, "a rotation");
    }
}

#[test]
fn band_samples_are_reproducible_and_inside() {
    let band = band();
    let set = band.sample(40, 7).expect("a good band");
    assert_eq!(set, band.sample(40, 7).expect("a good band"), "same seed, same cameras");
    assert_ne!(set, band.sample(40, 8).expect("a good band"), "another seed, other cameras");
    assert_eq!(set.views[..9], band.sample(9, 7).expect("a good band").views, "a longer set goes on");
    for view in &set.views {
        let side = view.camera.position() - band.target;
        let elevation = (side.z / side.length()).asin().to_degrees();
        // Positions are rounded to f32.
        assert!((2.9999..=5.0001).contains(&side.length()), "{}", side.length());
        assert!((9.999..=60.001).contains(&elevation), "{elevation}");
    }
    let sides = set.views.iter().map(|view| view.camera.position().x > band.target.x);
    let right = sides.filter(|right| *right).count();
    assert!((8..=32).contains(&right), "both sides are visited: {right} of 40");
}

#[test]
fn impossible_paths_are_usage_errors() {
    let refuse = |result: Result<CameraSet, EngineError>, word: &str| {
        let error = result.expect_err(word);
        assert_eq!(error.exit_code(), 2, "{error}");
        assert!(error.to_string().contains(word), "`{word}` is not in `{error}`");
    };
    refuse(orbit(0).cameras(), "views");
    refuse(Orbit { radius: 0.0, ..orbit(1) }.cameras(), "radius");
    refuse(Orbit { radius: f64::NAN, ..orbit(1) }.cameras(), "radius");
    refuse(Orbit { elevation_deg: 91.0, ..orbit(1) }.cameras(), "elevation");
    refuse(Orbit { target: Vec3::NAN, ..orbit(1) }.cameras(), "target");
    refuse(Orbit { lens: Lens { fov_x_rad: 3.2, ..lens() }, ..orbit(1) }.cameras(), "field of view");
    refuse(Band { radius: 5.0..=3.0, ..band() }.sample(1, 0), "radius");
    refuse(Band { azimuth_deg: 0.0..=720.0, ..band() }.sample(1, 0), "azimuth");
    assert_eq!(ImageSize::new(0, 5).expect_err("no width").exit_code(), 2);
}

#[test]
fn resizing_keeps_the_view() {
    let camera = orbit(1).cameras().expect("a good orbit").views[0].camera;
    let half = camera.resized(size(32, 24));
    assert_eq!((half.tan_fovx(), half.tan_fovy()), (camera.tan_fovx(), camera.tan_fovy()));
    assert_eq!((half.cx, half.cy), (15.5, 11.5), "still the middle");
    assert_eq!(half.resized(size(64, 48)), camera);
}

#[test]
fn the_scene_centre_ignores_strays() {
    let mut means = vec![[1.0, 2.0, 3.0]; 9];
    means.push([1e9, -1e9, f32::MAX]);
    let splats = Gaussians { means, ..Gaussians::default() };
    assert_eq!(splats.median_centre(), [1.0, 2.0, 3.0]);
    assert_eq!(Gaussians::default().median_centre(), [0.0; 3], "no splats");
}

#[test]
fn positions_invert_the_view_transform() {
    let set = band().sample(10, 3).expect("a good band");
    for view in &set.views {
        let Camera { world_to_camera, .. } = view.camera;
        assert_near(world_to_camera.transform_point3(view.camera.position()), Vec3::ZERO, POSE_TOLERANCE);
    }
}

proptest! {
    #[test]
    fn random_bytes_never_panic(bytes: Vec<u8>) {
        prop_assert!(CameraSet::parse(Path::new("x"), &bytes, ImageSize::DNERF).is_err());
    }

    #[test]
    fn random_numbers_never_panic(values: [f64; 16], angle: f64, time: f64) {
        let rows: Vec<&[f64]> = values.chunks(4).collect();
        let file = json!({ "camera_angle_x": angle, "frames": [{ "time": time, "transform_matrix": rows }] });
        drop(parse(&file));
    }
}
