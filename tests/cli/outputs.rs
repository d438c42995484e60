//! Outputs appear whole or not at all.

use std::fs;
use std::process::Command;

use super::{guard4d, names, put, scratch};
use crate::scene::fixture::TinyModel;
use crate::support::gpu::device;

#[test]
fn what_exists_is_kept_unless_asked() {
    if device().is_none() {
        return;
    }
    let (folder, tiny) = (scratch(), TinyModel::new());
    let model = tiny.path();
    let out = put(folder.path(), "out.safetensors", b"precious");
    let dump = [&"dump" as &dyn AsRef<std::ffi::OsStr>, &"deform", &model, &"--time", &"0", &"--out", &out];
    guard4d(&dump).refused(73, &["out.safetensors: cannot create", "it exists; --overwrite replaces it"]);
    assert_eq!(fs::read(&out).expect("readable"), b"precious", "untouched");
    guard4d(&[&dump[..], &[&"--overwrite"]].concat()).done();
    assert!(fs::read(&out).expect("readable") != b"precious", "replaced");
    let frames = folder.path().join("frames");
    put(&frames, "mine.txt", b"precious");
    let small: [&dyn AsRef<std::ffi::OsStr>; 6] = [&"--orbit", &"1", &"--frames", &"2", &"--size", &"32x32"];
    let render = [&[&"render" as &dyn AsRef<std::ffi::OsStr>, &model, &"--out", &frames], &small[..]].concat();
    guard4d(&render).refused(73, &["frames: cannot create", "it exists"]);
    assert_eq!(names(&frames), ["mine.txt"], "untouched");
    guard4d(&[&render[..], &[&"-w"]].concat()).done();
    assert_eq!(names(&frames), ["00000.png", "00001.png"], "replaced as a whole");
    let video = put(folder.path(), "clip.mp4", b"precious");
    guard4d(&[&[&"render" as &dyn AsRef<std::ffi::OsStr>, &model, &"--out", &video], &small[..]].concat())
        .refused(73, &["clip.mp4: cannot create", "it exists"]);
    let marked = folder.path().join("marked");
    put(&marked, "mine.txt", b"precious");
    guard4d(&[&"embed", &model, &"--key", &"none.key", &"--out", &marked]).refused(73, &["marked: cannot create"]);
    assert_eq!(names(folder.path()), ["clip.mp4", "frames", "marked", "out.safetensors"], "no partial output is left");
}

/// Permission bits do not stop root, so a file stands where a folder is needed.
#[test]
fn a_place_that_cannot_be_written_is_told() {
    if device().is_none() {
        return;
    }
    let (folder, model) = (scratch(), TinyModel::new());
    let file = put(folder.path(), "file", b"");
    let out = file.join("out");
    guard4d(&[&"render", &model.path(), &"--out", &out]).refused(73, &["out: cannot create"]);
    guard4d(&[&"keygen", &"--bits", &"8", &"--out", &out.join("owner.key")]).refused(73, &["owner.key: cannot create"]);
    guard4d(&[&"dump", &"deform", &model.path(), &"--time", &"0", &"--out", &out]).refused(73, &["out: cannot create"]);
    assert_eq!(names(folder.path()), ["file"], "nothing is written");
}

#[test]
fn a_full_disk_leaves_nothing_behind() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let scene = guard4d_engine::demo::Scene::unpack().expect("the scene unpacks");
    // The mount lives in a namespace of its own and goes with it.
    let script = "mount -t tmpfs -o size=64k tmpfs \"$1\" || exit 99
        shift; \"$@\"; code=$?; ls -A \"$(dirname \"$0\")/disk\"; exit $code";
    let disk = folder.path().join("disk");
    fs::create_dir(&disk).expect("writable");
    let name = folder.path().join("script");
    let frames = ["--orbit", "1", "--frames", "2"].map(str::to_owned);
    let text = |path: &std::path::Path| path.display().to_string();
    let (scene, out) = (text(scene.path()), text(&disk.join("out")));
    let dump = ["dump", "deform", &scene, "--time", "0", "--out", &out].map(str::to_owned);
    let render = [&["render", &scene, "--out", &out].map(str::to_owned)[..], &frames].concat();
    for args in [dump.to_vec(), render] {
        let mut command = Command::new("unshare");
        command.args(["--user", "--map-root-user", "--mount", "sh", "-c", script]).arg(&name).arg(&disk);
        let ran = command.arg(env!("CARGO_BIN_EXE_guard4d")).args(&args).env("NO_COLOR", "1").output();
        let Some(output) = ran.ok().filter(|o| o.status.code().is_some_and(|c| c != 99 && c != 1)) else {
            crate::support::skipped("this user may not mount a small file system");
            return;
        };
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(74), "exit code of {args:?}: {stderr}");
        assert!(stderr.contains("No space left on device"), "{stderr}");
        assert_eq!(String::from_utf8_lossy(&output.stdout), "", "the disk is empty again after {args:?}");
    }
}
