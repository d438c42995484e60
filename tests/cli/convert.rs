//! `guard4d convert`: moments and formats.

use std::fs;

use guard4d_engine::render::deform::DeformField;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::{Model, Motion, PlyFile, ply};

use super::{guard4d, scratch};
use crate::support::fixture::gaussians;
use crate::support::gpu::device;

#[test]
fn a_static_scene_needs_no_device_and_floats_lose_nothing() {
    let folder = scratch();
    let at = |name: &str| folder.path().join(name);
    let splats = gaussians(40, 2, 8);
    fs::write(at("scene.ply"), ply::encode(&splats)).expect("writable");
    // No device has this name, so none is opened.
    let device = ["--device", "name:none-of-this-name"];
    let convert = |from: &str, to: &str| guard4d(&[&"convert", &at(from), &at(to), &device[0], &device[1]]);
    assert_eq!(convert("scene.ply", "scene.glb").code, 0, "to glTF");
    assert_eq!(convert("scene.glb", "back.ply").code, 0, "and back");
    let back = PlyFile::open(&at("back.ply")).and_then(|ply| ply.decode()).expect("a PLY");
    assert_eq!((&back.sh_coeffs, &back.means), (&splats.sh_coeffs, &splats.means), "to the bit");
    convert("scene.ply", "scene.glb").refused(73, &["scene.glb", "exists"]);
    fs::write(at("scene.glb"), b"old").expect("writable");
    for flag in ["-w", "--overwrite"] {
        guard4d(&[&"convert", &at("scene.ply"), &at("scene.glb"), &flag]).done();
        assert!(fs::read(at("scene.glb")).expect("readable").len() > 100, "{flag} replaces it");
    }
    convert("scene.ply", "scene.obj").refused(2, &["scene.obj", ".ply, .glb or .spz"]);
}

#[test]
fn formats_that_round_must_be_asked_for() {
    let folder = scratch();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("scene.ply"), ply::encode(&gaussians(40, 3, 9))).expect("writable");
    guard4d(&[&"convert", &at("scene.ply"), &at("scene.spz")]).refused(2, &["rounds colours", "--lossy"]);
    assert!(!at("scene.spz").exists(), "nothing was written");
    let run = guard4d(&[&"convert", &at("scene.ply"), &at("scene.spz"), &"--lossy"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stderr.contains("was not looked at") && run.stderr.contains("guard4d verify"), "{}", run.stderr);
    assert_eq!(Model::open(&at("scene.spz")).expect("an SPZ").gaussians.len(), 40);
}

#[test]
fn moments_of_a_moving_scene_are_files_of_their_own() {
    let Some(gpu) = device() else { return };
    let (folder, scene) = (scratch(), DemoScene::unpack().expect("the scene unpacks"));
    let out = folder.path().join("take");
    let run = guard4d(&[&"convert", &scene.path(), &out, &"--moments", &"3"]);
    assert_eq!(run.code, 0, "{}", run.stderr);
    let take = Model::open(&out).expect("a sequence");
    let Motion::Sequence(moments) = &take.motion else { panic!("{:?}", take.motion) };
    let model = Model::open(scene.path()).expect("the scene opens");
    let mut field = DeformField::new(&gpu, &model.gaussians, &model.motion).expect("it fits");
    for (moment, time) in moments.iter().zip([0.0, 0.5, 1.0]) {
        assert_eq!(moment, &field.at(time).and_then(|state| state.read()).expect("readable"), "time {time}");
    }
    assert_ne!(moments[0].means, moments[1].means, "it moves");
    let one = folder.path().join("half.ply");
    assert_eq!(guard4d(&[&"convert", &scene.path(), &one, &"--time", &"0.5"]).code, 0);
    let half = PlyFile::open(&one).and_then(|ply| ply.decode()).expect("a PLY");
    assert_eq!(&half, &moments[1], "the same moment");
    guard4d(&[&"convert", &scene.path(), &one, &"--overwrite", &"--time", &"1.5"])
        .refused(2, &["--time", "1.5", "0 to 1"]);
}
