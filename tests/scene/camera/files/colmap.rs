//! Reconstructions of COLMAP: what is read of them, and what is refused by file and field.

use std::fs;
use std::path::{Path, PathBuf};

use glam::Vec3;
use guard4d_engine::error::EngineError;
use guard4d_engine::scene::CameraSet;
use proptest::prelude::*;

use super::{folder, open, shots};
use crate::scene::{assert_refused, bad_data};
use crate::support::camera_writers::{Format, colmap_binary, put};

/// Poses by hand, so that writer and reader cannot be wrong alike.
#[test]
fn colmap_text_is_read_as_it_is_documented() {
    let folder = folder();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let cameras = "# comment\n\n7 SIMPLE_PINHOLE 320 240 250 160 120\n9 PINHOLE 100 80 90 95 49.5 40.25\n\
                   3 SIMPLE_RADIAL 10 10 5 5 5 0\n4 RADIAL 10 10 5 5 5 0 0\n5 FOV 10 10 5 5 5 5 0\n\
                   6 FULL_OPENCV 10 10 5 5 5 5 0 0 0 0 0 0 0 0\n";
    // Turned by +90 degrees about x: y of the world is z of the camera, z of the world is -y of it.
    let images = format!(
        "# comment\n2 {half} {half} 0 0 1 2 3 9 b with spaces.png\n0.5 0.5 -1 1.5 1.5 4\n\
         1 1 0 0 0 0 0 0 7 a.png\n\n   \n# comment\n3 -1 0 0 0 0 0 5 7 c.png"
    );
    put(folder.path(), "cameras.txt", cameras.as_bytes());
    put(folder.path(), "images.txt", images.as_bytes());
    let set = open(folder.path()).expect("a reconstruction");
    assert!(!set.in_sequence, "photos are no film");
    let names: Vec<&str> = set.views.iter().map(|view| view.name.as_str()).collect();
    assert_eq!(names, ["a.png", "b with spaces.png", "c.png"], "in the order of their names");
    let [a, b, c] = [0, 1, 2].map(|i: usize| set.views[i].camera);
    assert_eq!(a.world_to_camera, glam::Mat4::IDENTITY);
    assert_eq!((a.fx, a.fy, a.cx, a.cy, a.width, a.height), (250.0, 250.0, 159.5, 119.5, 320, 240));
    assert_eq!((b.fx, b.fy, b.cx, b.cy, b.width, b.height), (90.0, 95.0, 49.0, 39.75, 100, 80));
    let seen = b.world_to_camera.transform_point3(Vec3::new(10.0, 20.0, 30.0));
    // Numbers up to 30 pass through a rotation in f32.
    assert!(seen.distance(Vec3::new(11.0, -28.0, 23.0)) < 1e-5, "{seen}");
    assert_eq!(c.position(), Vec3::new(0.0, 0.0, -5.0), "-q turns as q does");
    assert_eq!(set.entries().count(), 0, "no time is invented");
}

#[test]
fn reconstructions_are_found_where_colmap_keeps_them() {
    let (binary, text) = (folder(), folder());
    Format::ColmapBinary.write(binary.path(), &shots());
    Format::ColmapText.write(text.path(), &shots()[..1]);
    let root = folder();
    let copy = |from: PathBuf, to: &str| {
        let to = root.path().join(to);
        fs::create_dir_all(&to).expect("writable");
        for file in fs::read_dir(from).expect("a folder").map(|file| file.expect("a file")) {
            fs::copy(file.path(), to.join(file.file_name())).expect("writable");
        }
    };
    let views = || open(root.path()).expect("a reconstruction").views.len();
    assert_refused(open(root.path()), &["folder", "no cameras", "sparse/0", "dataset.json"]);
    copy(binary.path().join("binary/sparse/0"), "sparse");
    assert_eq!(views(), 3);
    copy(text.path().join("text"), "sparse");
    assert_eq!(views(), 3, "binary before text");
    copy(text.path().join("text"), "sparse/0");
    assert_eq!(views(), 1, "the first model of a data set");
    copy(binary.path().join("binary/sparse/0"), "");
    assert_eq!(views(), 3, "the folder itself");
    fs::remove_file(root.path().join("images.bin")).expect("there");
    assert_eq!(views(), 1, "whole pairs first");
    let missing = |folder: &Path, word: &str| {
        let error = open(folder).expect_err("a file is missing");
        assert_eq!(error.exit_code(), 66, "{error}");
        assert!(error.to_string().contains(word), "`{word}` is not in `{error}`");
    };
    let alone = folder();
    put(alone.path(), "cameras.txt", b"");
    missing(alone.path(), "images.txt");
    missing(&alone.path().join("nowhere"), "nowhere");
}

fn colmap_with(cameras: &str, images: &str) -> Result<CameraSet, EngineError> {
    let folder = folder();
    put(folder.path(), "cameras.txt", cameras.as_bytes());
    put(folder.path(), "images.txt", images.as_bytes());
    open(folder.path())
}

#[test]
fn malformed_colmap_text_is_refused_by_line() {
    let camera = "1 PINHOLE 64 48 60 60 32 24\n";
    let image = "5 1 0 0 0 0 0 0 1 a.png\n\n";
    assert_eq!(colmap_with(camera, image).expect("a reconstruction").views.len(), 1);
    let cameras = |text: &str, words: &[&str]| assert_refused(colmap_with(text, image), words);
    cameras("1 PINHOLE 64 48 60 60 32\n", &["line 1: number of parameters", "`3`", "4 for PINHOLE"]);
    cameras("\n1 PINBALL 64 48 60\n", &["line 2: model", "`PINBALL`", "SIMPLE_RADIAL"]);
    cameras("x PINHOLE 64 48 60 60 32 24", &["line 1: camera number", "`x`", "a whole number"]);
    cameras("1 PINHOLE -64 48 60 60 32 24", &["line 1: width", "`-64`"]);
    cameras("1 PINHOLE 64", &["line 1: height", "``"]);
    cameras("1 PINHOLE 64 48 NaN 60 32 24", &["line 1: parameter", "`NaN`", "a finite number"]);
    cameras("1 PINHOLE 64 48 0 60 32 24", &["camera 1: focal length", "positive"]);
    cameras("1 PINHOLE 64 48 60 60 1e300 24", &["camera 1: principal point", "a finite number"]);
    cameras("1 PINHOLE 64 99999999999 60 60 32 24", &["camera 1: image size", "64x99999999999"]);
    cameras("1 OPENCV 64 48 60 60 32 24 0 0.01 0 0", &["camera 1: lens distortion", "0.01", "image_undistorter"]);
    cameras("1 OPENCV_FISHEYE 64 48 60 60 32 24 0 0 0 0", &["camera 1: model", "OPENCV_FISHEYE"]);
    cameras(&camera.repeat(2), &["camera 1", "there twice"]);
    cameras("# nothing\n", &["image 5: camera", "1", "a camera of the cameras file"]);
    let images = |text: &str, words: &[&str]| assert_refused(colmap_with(camera, text), words);
    images("# nothing\n", &["cameras", "none"]);
    images("5 1 0 0 0 0 0 0 2 a.png\n\n", &["image 5: camera", "2"]);
    images("5 1 0 0 0 0 0 0 1\n\n", &["line 1: name", "0 bytes"]);
    images(&format!("5 1 0 0 0 0 0 0 1 {}\n\n", "a".repeat(4097)), &["line 1: name", "4097 bytes"]);
    images("5 1 0 0 0 0 0 inf 1 a.png\n\n", &["line 1: pose", "`inf`"]);
    images("5 1 0 0\n", &["line 1: pose", "``"]);
    images("5 0.9 0 0 0 0 0 0 1 a.png\n\n", &["image 5: rotation", "0.9", "length 1"]);
    images("5 0 0 0 0 0 0 0 1 a.png\n\n", &["image 5: rotation", "length 1"]);
    images("5 1 0 0 0 1e300 0 0 1 a.png\n\n", &["image 5: pose", "a finite position"]);
    let unpaired = "5 1 0 0 0 0 0 0 1 a.png\n6 1 0 0 0 0 0 0 1 b.png\n";
    images(unpaired, &["line 2: points of an image", "b.png", "an empty line"]);
    let folder = folder();
    put(folder.path(), "cameras.txt", camera.as_bytes());
    put(folder.path(), "images.txt", b"\xff\xfe");
    assert_refused(open(folder.path()), &["text", "UTF-8"]);
}

fn binary(cameras: &[u8], images: &[u8]) -> Result<CameraSet, EngineError> {
    let folder = folder();
    put(folder.path(), "cameras.bin", cameras);
    put(folder.path(), "images.bin", images);
    open(folder.path())
}

#[test]
fn malformed_colmap_binaries_are_refused_by_field() {
    let (cameras, images) = colmap_binary(&shots());
    assert_eq!(binary(&cameras, &images).expect("a reconstruction").views.len(), 3);
    for end in 0..cameras.len() {
        bad_data(binary(&cameras[..end], &images));
    }
    for end in 0..images.len() {
        bad_data(binary(&cameras, &images[..end]));
    }
    assert_refused(binary(&cameras[..7], &images), &["number of cameras", "7 bytes are left", "8 bytes"]);
    assert_refused(binary(&cameras[..cameras.len() - 1], &images), &["camera 3: parameters", "7 bytes are left"]);
    assert_refused(binary(&cameras, &[&images[..], &[0]].concat()), &["end of the images", "1 bytes more"]);
    // Behind the count: number 0, model 4, width 8, height 16, parameters 24.
    let camera = |at: usize, bytes: &[u8]| {
        let mut file = cameras.clone();
        file[8 + at..][..bytes.len()].copy_from_slice(bytes);
        binary(&file, &images)
    };
    assert_refused(camera(4, &77_i32.to_le_bytes()), &["camera 1: model", "77", "0 to 11"]);
    assert_refused(camera(4, &(-1_i32).to_le_bytes()), &["camera 1: model", "-1"]);
    assert_refused(camera(8, &u64::MAX.to_le_bytes()), &["camera 1: image size", "18446744073709551615x48"]);
    assert_refused(camera(24, &f64::NAN.to_le_bytes()), &["camera 1: parameters", "NaN"]);
    assert_refused(camera(0, &2_u32.to_le_bytes()), &["camera 2", "there twice"]);
    let mut many = cameras.clone();
    many[..8].copy_from_slice(&u64::MAX.to_le_bytes());
    assert_refused(binary(&many, &images), &["number of cameras", "18446744073709551615", "at most 3"]);
    // Behind the count: number 0, rotation 4, translation 36, camera 60, name 64, points 72.
    let image = |at: usize, bytes: &[u8]| {
        let mut file = images.clone();
        file[8 + at..][..bytes.len()].copy_from_slice(bytes);
        binary(&cameras, &file)
    };
    assert_refused(image(4, &3.0_f64.to_le_bytes()), &["image 11: rotation", "length 1"]);
    assert_refused(image(4, &f64::INFINITY.to_le_bytes()), &["image 11: pose", "inf"]);
    assert_refused(image(36, &1e300_f64.to_le_bytes()), &["image 11: pose", "a finite position"]);
    assert_refused(image(60, &9_u32.to_le_bytes()), &["image 11: camera", "9"]);
    assert_refused(image(72, &(u64::MAX / 24 + 2).to_le_bytes()), &["image 11: number of points", "the file has room"]);
    let mut many = images.clone();
    many[..8].copy_from_slice(&(1_u64 << 40).to_le_bytes());
    assert_refused(binary(&cameras, &many), &["number of images", "1099511627776", "at most"]);
    let endless = [&images[..72], &[b'a'; 5000]].concat();
    assert_refused(binary(&cameras, &endless), &["image 11: name", "no end", "4096 bytes"]);
}

proptest! {
    #[test]
    fn random_binaries_never_panic(cameras: Vec<u8>, images: Vec<u8>) {
        prop_assert!(binary(&cameras, &images).is_err());
    }

    /// A few bytes of a good file are replaced, so that what follows its header is reached.
    #[test]
    fn damaged_binaries_never_panic(
        edits in prop::collection::vec((any::<bool>(), any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let (mut cameras, mut images) = colmap_binary(&shots());
        for (in_images, at, byte) in edits {
            let file = if in_images { &mut images } else { &mut cameras };
            let at = at.index(file.len());
            file[at] = byte;
        }
        if let Ok(set) = binary(&cameras, &images) {
            prop_assert!(set.views.iter().all(|view| view.camera.world_to_camera.is_finite()), "poses are finite");
        }
    }

    #[test]
    fn random_text_never_panics(cameras: String, images: String) {
        drop(colmap_with(&cameras, &images));
    }
}
