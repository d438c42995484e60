//! Camera paths of nerfstudio: films, and what is refused by field.

use glam::Vec3;
use serde_json::{Value, json};

use super::super::POSE_TOLERANCE;
use super::parse;
use crate::scene::assert_refused;

fn path_file() -> Value {
    let stop = |x: f64| {
        json!({ "camera_to_world": [1, 0, 0, x, 0, 0, -1, -4, 0, 1, 0, 0, 0, 0, 0, 1],
                "fov": 60.0, "aspect": 2 })
    };
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
