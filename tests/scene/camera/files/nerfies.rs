//! Folders of Nerfies: what is read of them, and what is refused by file and field.

use std::fs;

use guard4d_engine::error::EngineError;
use guard4d_engine::scene::CameraSet;
use serde_json::{Value, json};

use super::{assert_is, folder, open, shots};
use crate::scene::assert_refused;
use crate::support::camera_writers::{Format, put};

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
