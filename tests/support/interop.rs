//! Other people's programs, which `./x interop` fetches.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use guard4d_engine::media::Frame;
use guard4d_engine::media::ffmpeg::Ffmpeg;
use guard4d_engine::media::folder::read_picture;
use guard4d_engine::scene::ply::encode;
use guard4d_engine::scene::{CameraSet, Gaussians};

use super::repo;

/// A program or folder that `./x interop` names in the environment. `None`, with the reason printed, where it does not.
pub(crate) fn program(variable: &str) -> Option<PathBuf> {
    let found = std::env::var_os(variable).map(PathBuf::from);
    if found.is_none() {
        println!("SKIPPED {variable} is not set; `./x interop` sets it");
    }
    found
}

/// What a program prints that has to end well.
#[track_caller]
pub(crate) fn run(command: &mut Command) -> String {
    let output = command.output().expect("it starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {said}");
    String::from_utf8(output.stdout).expect("text")
}

/// What the viewer of a page in `tests/interop/viewers.cjs` shows, also left in `folder` as numbered pictures; nothing
/// where there is no viewer.
pub(crate) fn filmed(page: &str, folder: &Path, splats: &Gaussians, cameras: &CameraSet) -> Option<Vec<Frame>> {
    let (modules, browser) = (program("GUARD4D_NODE_MODULES")?, program("GUARD4D_CHROMIUM")?);
    let (ply, film) = (folder.join("scene.ply"), folder.join("cameras.json"));
    fs::write(&ply, encode(splats)).expect("writable");
    fs::write(&film, cameras.film_json()).expect("writable");
    let mut node = Command::new("node");
    node.env("NODE_PATH", &modules).arg(repo("tests/interop/viewers.cjs")).arg(browser).arg(&modules);
    run(node.args([page.as_ref(), ply.as_os_str(), film.as_os_str(), folder.as_os_str()]));
    let picture = |number: usize| {
        let path = folder.join(format!("{number:05}.png"));
        read_picture(&path, [0; 3], &Ffmpeg::default()).expect("a picture")
    };
    Some((0..cameras.clips().concat().len()).map(picture).collect())
}
