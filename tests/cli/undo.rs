//! `guard4d undo` on the outputs of a small embedding.

use std::fs;
use std::path::Path;

use guard4d_engine::scene::demo::DemoScene;

use super::{guard4d, names, scratch};
use crate::support::gpu::device;
use crate::support::owner::delivered;

#[test]
fn undo_restores_the_original_or_nothing() {
    let Some(gpu) = device() else { return };
    let owner = delivered(&gpu);
    let folder = scratch();
    let (marked, undo) = (owner.join("out/marked"), owner.join("out/private/undo.safetensors"));
    let out = folder.path().join("restored");
    let restore = |file: &Path| guard4d(&[&"undo", &marked, &"--undo", &file, &"--out", &out]);
    restore(&owner.join("out/private/extractor.safetensors")).refused(65, &["extractor.safetensors: format"]);
    restore(&folder.path().join("nowhere")).refused(66, &["nowhere: not found"]);
    assert_eq!(names(folder.path()), [""; 0], "nothing is written");
    restore(&undo).done();
    let scene = DemoScene::unpack().expect("the scene unpacks");
    let ply = "point_cloud/iteration_20000/point_cloud.ply";
    let read = |path: &Path| fs::read(path.join(ply)).expect("a PLY");
    assert!(read(&out) == read(scene.path()), "the original, byte for byte");
    restore(&undo).refused(73, &["restored: cannot create", "it exists"]);
    let before = read(&out);
    guard4d(&[&"undo", &out, &"--undo", &undo, &"--out", &out, &"-w"])
        .refused(65, &["undo.safetensors: original", "a model whose original hashes to"]);
    assert!(read(&out) == before, "what was there is kept when there is nothing to put in its place");
    guard4d(&[&"undo", &marked, &"--undo", &undo, &"--out", &out, &"-w"]).done();
    assert_eq!(names(folder.path()), ["restored"], "replaced as a whole");
}

#[test]
fn undo_asks_for_its_files() {
    guard4d(&[&"undo", &"marked", &"--out", &"x"]).refused(2, &["--undo <FILE>"]);
    guard4d(&[&"undo", &"marked", &"--undo", &"u"]).refused(2, &["--out <DIR>"]);
    guard4d(&[&"embed", &"marked", &"--undo", &"u", &"--out", &"x"]).refused(2, &["unexpected argument '--undo'"]);
}
