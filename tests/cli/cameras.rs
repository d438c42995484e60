//! `--cameras` in all its kinds, and flights through them.

use std::ffi::OsStr;
use std::path::Path;

use glam::DVec3;
use guard4d_engine::media::Frame;
use guard4d_engine::media::clip::read_clip;
use guard4d_engine::media::options::ReadOptions;
use guard4d_engine::scene::ply;

use super::{guard4d, put, scratch};
use crate::support::camera_writers::{Format, Shot};
use crate::support::fixture::gaussians;
use crate::support::gpu::device;

/// Two cameras, 48x32, that are two units apart.
fn shots() -> [Shot; 2] {
    [-1.0, 1.0].map(|x| Shot::looking(DVec3::new(x, -4.0, 1.0), DVec3::ZERO, 50.0, [48, 32]))
}

fn render(model: &Path, cameras: &Path, out: &Path, flags: &[&str]) -> Vec<Frame> {
    let mut args: Vec<&dyn AsRef<OsStr>> = vec![&"render", &model, &"--cameras", &cameras, &"--out", &out];
    args.extend(flags.iter().map(|flag| flag as &dyn AsRef<OsStr>));
    guard4d(&args).done();
    read_clip(out, &ReadOptions::default()).expect("a film").frames().to_vec()
}

fn sizes(frames: &[Frame]) -> Vec<(u32, u32)> {
    frames.iter().map(|frame| (frame.width(), frame.height())).collect()
}

#[test]
fn films_take_cameras_of_every_kind_and_the_size_that_they_say() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let model = put(folder.path(), "model.ply", &ply::encode(&gaussians(8, 0, 1)));
    for format in Format::ALL {
        let cameras = format.write(folder.path(), &shots());
        let film = |name: &str, flags: &[&str]| {
            render(&model, &cameras, &folder.path().join(format!("{format:?}_{name}")), flags)
        };
        // D-NeRF's files tell no size.
        let own = if format == Format::Dnerf { (400, 400) } else { (48, 32) };
        assert_eq!(sizes(&film("own", &["--frames", "1"])), [own; 2], "{format:?}");
        assert_eq!(sizes(&film("told", &["--frames", "1", "--size", "24x16"])), [(24, 16); 2], "{format:?}");
        let flight = film("flight", &["--interpolate", "5", "--size", "24x16"]);
        assert_eq!(sizes(&flight), [(24, 16); 5], "{format:?}");
    }
}

#[test]
fn flights_pass_their_cameras_and_close() {
    if device().is_none() {
        return;
    }
    let folder = scratch();
    let model = put(folder.path(), "model.ply", &ply::encode(&gaussians(8, 0, 1)));
    let cameras = Format::ColmapBinary.write(folder.path(), &shots());
    let film = |name: &str, flags: &[&str]| render(&model, &cameras, &folder.path().join(name), flags);
    let [left, right] = [0, 1].map(|i| film("photos", &["--frames", "1", "-w"])[i].rgb().to_vec());
    assert!(left != right, "the cameras differ");
    // A pose that goes through a quaternion is rounded again, which may move an 8-bit value by one.
    let is = |frame: &Frame, want: &[u8]| frame.rgb().iter().zip(want).all(|(a, b)| a.abs_diff(*b) <= 1);
    let open = film("open", &["--interpolate", "3"]);
    assert!(is(&open[0], &left) && is(&open[2], &right) && !is(&open[1], &left), "from the first to the last");
    let closed = film("closed", &["--interpolate", "4", "--closed"]);
    assert!(is(&closed[0], &left) && is(&closed[2], &right) && !is(&closed[3], &left), "there and on the way back");
    let out = folder.path().join("none");
    let refuse = |flags: &[&str], word: &str| {
        let mut args: Vec<&dyn AsRef<OsStr>> = vec![&"render", &model, &"--out", &out];
        args.extend(flags.iter().map(|flag| flag as &dyn AsRef<OsStr>));
        guard4d(&args).refused(2, &[word]);
    };
    let path = cameras.to_str().expect("a plain name");
    refuse(&["--interpolate", "3"], "--cameras");
    refuse(&["--cameras", path, "--closed"], "--interpolate");
    refuse(&["--cameras", path, "--interpolate", "0"], "frames of a flight: 0");
    let empty = scratch();
    guard4d(&[&"render", &model, &"--out", &out, &"--cameras", &empty.path()]).refused(65, &["no cameras", "sparse/0"]);
    assert!(!out.exists(), "no output, whole or partial");
}

#[test]
fn a_video_has_the_size_of_its_cameras() {
    if device().is_none() || !crate::support::has_ffmpeg() {
        return;
    }
    let folder = scratch();
    let model = put(folder.path(), "model.ply", &ply::encode(&gaussians(8, 0, 1)));
    let cameras = Format::Inria.write(folder.path(), &shots());
    let film = render(&model, &cameras, &folder.path().join("film.mp4"), &["--interpolate", "4"]);
    assert_eq!(sizes(&film), [(48, 32); 4]);
}
