//! Pictures of light instead of code values.

use std::fs;
use std::num::NonZeroU32;
use std::path::Path;

use guard4d_engine::media::ffmpeg::Ffmpeg;
use guard4d_engine::media::folder::read_picture;
use guard4d_engine::media::png::write_png;
use guard4d_engine::media::{Frame, ReadOptions, read_clip};

use super::{code, ffmpeg};

/// Writes an OpenEXR picture of planes G, B, R and perhaps A.
fn exr(path: &Path, width: usize, planes: &[f32], arguments: &str) {
    let channels = if planes.len() == 4 * width { "gbrapf32le" } else { "gbrpf32le" };
    let raw = path.with_extension("raw");
    let bytes: Vec<u8> = planes.iter().flat_map(|sample| sample.to_le_bytes()).collect();
    fs::write(&raw, bytes).expect("the folder is writable");
    ffmpeg(&format!("-f rawvideo -pix_fmt {channels} -s {width}x1 -i {} {arguments}", raw.display()), path);
    fs::remove_file(raw).expect("written above");
}

#[test]
fn openexr_light_becomes_srgb_code_values() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("x.exr");
    let read = |background| read_picture(&path, background, &Ffmpeg::default()).unwrap_or_else(|e| panic!("{e}"));
    // IEC 61966-2-1: light of 0.18 is code 117.6 of 255, 0.5 is 187.5, 0.001 is 3.3, 0.25 is 136.96; above 1 is white.
    let green = [0.0, 0.18, 0.5, 1.0];
    let blue = [0.001, 0.25, 7.5, -1.0];
    let red = [1.0, 0.0, 0.25, f32::INFINITY];
    for arguments in ["-format float", "-format half -compression zip16", "-format float -compression rle"] {
        exr(&path, 4, &[green, blue, red].concat(), arguments);
        let want = [[255, 0, 3], [0, 118, 137], [137, 188, 255], [255, 255, 0]];
        assert_eq!(read([0; 3]).rgb(), want.concat(), "{arguments}");
    }
    // Half covered by light that is already halved, over black and over white; and nothing at all.
    exr(&path, 2, &[0.25, 0.0, 0.25, 0.0, 0.25, 0.0, 0.5, 0.0], "-format float");
    assert_eq!(read([0; 3]).rgb(), [137, 137, 137, 0, 0, 0], "over black");
    // 0.25 + 0.5 of 1 is light of 0.75, code 224.6.
    assert_eq!(read([255; 3]).rgb(), [225, 225, 225, 255, 255, 255], "over white");

    exr(&path, 2, &[0.0, f32::NAN, 0.0, 0.0, 0.0, 0.0], "-format float");
    let error = read_picture(&path, [0; 3], &Ffmpeg::default()).expect_err("NaN");
    assert_eq!(error.exit_code(), 70, "{error}");
    let bytes = fs::read(&path).expect("written above");
    for (what, broken) in [("cut", &bytes[..bytes.len() / 2]), ("text", &b"not a picture at all"[..]), ("empty", &[])] {
        fs::write(&path, broken).expect("the folder is writable");
        assert_eq!(code(read_picture(&path, [0; 3], &Ffmpeg::default())), 65, "{what}");
    }
    assert_eq!(code(read_picture(&folder.path().join("no.exr"), [0; 3], &Ffmpeg::default())), 66, "missing");
    let absent = Ffmpeg { ffmpeg: "/nowhere/ffmpeg".into(), ffprobe: "/nowhere/ffprobe".into() };
    assert_eq!(code(read_picture(&path, [0; 3], &absent)), 69, "no ffmpeg");
    // A PNG by another name.
    let png = folder.path().join("x.png");
    write_png(&png, &Frame::new(2, 2, vec![9; 12]).expect("the length fits")).expect("the folder is writable");
    fs::rename(&png, &path).expect("the folder is writable");
    assert_eq!(code(read_picture(&path, [0; 3], &Ffmpeg::default())), 65, "a PNG");
}

#[test]
fn openexr_folders_are_films() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    for i in 8..12 {
        let light = i as f32 / 100.0;
        exr(&folder.path().join(format!("f.{i}.exr")), 2, &[light; 6], "-format float");
    }
    let options = ReadOptions { start: 1, max_frames: NonZeroU32::new(2), ..ReadOptions::default() };
    let clip = read_clip(folder.path(), &options).expect("a film");
    // Light of 0.09 and 0.10 is code 84.7 and 89.0 of 255.
    let levels: Vec<_> = clip.frames().iter().map(|frame| frame.rgb()[0]).collect();
    assert_eq!(levels, [85, 89], "the second and the third");
}
