//! Whether a path leads to a model or to a film.

use std::fs;

use guard4d_engine::media::Frame;
use guard4d_engine::media::png::write_png_folder;
use guard4d_engine::scene::demo::DemoScene;
use guard4d_engine::scene::formats::Export;
use guard4d_engine::scene::recognise::is_model;

use crate::support::fixture::{TinyModel, gaussians};

#[test]
fn models_are_told_by_their_content() {
    let (scene, tiny) = (DemoScene::unpack().expect("the scene unpacks"), TinyModel::new());
    assert!(is_model(scene.path()).expect("readable") && is_model(tiny.path()).expect("readable"), "trainers' folders");
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let splats = gaussians(4, 1, 1);
    for (name, export) in [("a.ply", Export::Ply), ("b.glb", Export::Glb), ("c.spz", Export::Spz)] {
        let moments = folder.path().join(name.replace('.', "-"));
        fs::create_dir(&moments).expect("writable");
        let bytes = export.encode(folder.path(), &splats).expect("it has room");
        fs::write(moments.join(name), &bytes).expect("writable");
        assert!(is_model(&moments).expect("readable"), "a folder of moments: {name}");
        let unnamed = folder.path().join(format!("{name}.txt"));
        fs::write(&unnamed, &bytes).expect("writable");
        assert!(is_model(&unnamed).expect("readable"), "whatever it is called: {name}");
    }
    let broken = folder.path().join("broken.ply");
    fs::write(&broken, b"plx").expect("writable");
    assert!(is_model(&broken).expect("readable"), "named as one, so that its reader says what is wrong");
}

#[test]
fn films_and_pictures_are_no_models() {
    let folder = tempfile::tempdir().expect("a temporary folder can be made");
    let film = folder.path().join("film");
    let frame = Frame::new(16, 16, vec![0; 3 * 16 * 16]).expect("the length fits");
    write_png_folder(&film, &[frame]).expect("writable");
    assert!(!is_model(&film).expect("readable") && !is_model(&film.join("00000.png")).expect("readable"));
    let video = folder.path().join("film.mp4");
    fs::write(&video, b"\0\0\0\x20ftypisom").expect("writable");
    assert!(!is_model(&video).expect("readable"), "no format of splats");
    assert!(!is_model(&folder.path().join("nowhere")).expect("nothing to read"), "nothing is there");
}
