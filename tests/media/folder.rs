//! Folders of pictures.

use std::fs;
use std::num::NonZeroU32;
use std::path::Path;

use guard4d_engine::error::EngineError;
use guard4d_engine::media::ffmpeg::Ffmpeg;
use guard4d_engine::media::folder::{list_pictures, read_picture};
use guard4d_engine::media::png::{write_png, write_png_folder};
use guard4d_engine::media::{Clip, Frame, Integrity, ReadOptions, read_clip};

use super::{ffmpeg, pngs, psnr, smooth};

const BLACK: [u8; 3] = [0; 3];

/// A frame whose samples differ from one another and from those of other seeds.
fn frame(width: u32, height: u32, seed: u32) -> Frame {
    let sample = |i: u32| ((i * 37 + seed * 101 + i * i % 17) % 256) as u8;
    Frame::new(width, height, (0..3 * width * height).map(sample).collect()).expect("the length fits")
}

fn code<T: std::fmt::Debug>(result: Result<T, EngineError>) -> u8 {
    result.expect_err("hostile input is refused").exit_code()
}

#[test]
fn png_folder_round_trips_bit_for_bit() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..12).map(|i| frame(7, 5, i)).collect();
    let target = folder.path().join("deep/clip");
    write_png_folder(&target, &frames).expect("the folder is writable");
    let clip = read_clip(&target, &ReadOptions::default()).expect("our own frames");
    assert_eq!(clip.frames(), frames);
    assert_eq!(clip.size_px(), (7, 5));
    assert_eq!(clip.integrity(), &Integrity::Intact);
    assert_eq!(Clip::from_frames(frames.clone()).expect("one size"), clip);
    assert_eq!(code(Clip::from_frames(Vec::new())), 2);
    assert_eq!(code(Clip::from_frames(vec![frame(7, 5, 0), frame(5, 7, 0)])), 2);
    assert_eq!(code(write_png_folder(&target, &frames)), 73, "old and new frames must not mix");

    let options = ReadOptions { max_frames: NonZeroU32::new(3), ..ReadOptions::default() };
    let start = read_clip(&target, &options).expect("our own frames");
    assert_eq!(start.frames(), &frames[..3]);
    assert_ne!(start.digest(), clip.digest());
}

#[test]
fn files_are_taken_in_natural_order() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let names = ["2.png", "10.png", "1.PNG", "v2_9.png", "v10_1.png", "010b.png", "99999999999999999999999.png"];
    for name in names {
        write_png(&folder.path().join(name), &frame(2, 2, 0)).expect("the folder is writable");
    }
    for other in ["notes.txt", ".hidden.png", "video.mp4"] {
        fs::write(folder.path().join(other), "x").expect("the folder is writable");
    }
    let listed = list_pictures(folder.path()).expect("it holds frames");
    let listed: Vec<_> = listed.iter().filter_map(|p| p.file_name()?.to_str()).collect();
    let order = ["1.PNG", "2.png", "10.png", "010b.png", "99999999999999999999999.png", "v2_9.png", "v10_1.png"];
    assert_eq!(listed, order);
}

#[test]
fn hostile_folders_are_refused_with_their_code() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let read = |path: &Path| code(read_clip(path, &ReadOptions::default()));
    assert_eq!(read(&folder.path().join("nowhere")), 66);
    assert_eq!(read(folder.path()), 65, "no frames");

    write_png(&folder.path().join("0.png"), &frame(4, 4, 0)).expect("the folder is writable");
    fs::write(folder.path().join("1.png"), b"\xff\xd8\xff\xe0 not a PNG").expect("the folder is writable");
    assert_eq!(read(folder.path()), 65, "a JPEG named .png");

    let whole = fs::read(folder.path().join("0.png")).expect("written above");
    fs::write(folder.path().join("1.png"), &whole[..whole.len() - 20]).expect("the folder is writable");
    assert_eq!(read(folder.path()), 65, "a cut PNG");

    fs::remove_file(folder.path().join("1.png")).expect("written above");
    write_png(&folder.path().join("1.png"), &frame(4, 5, 0)).expect("the folder is writable");
    let error = read_clip(folder.path(), &ReadOptions::default()).expect_err("two sizes").to_string();
    assert!(error.contains("1.png") && error.contains("4 x 5") && error.contains("4 x 4"), "{error}");

    let options = ReadOptions { max_bytes: 4 * 4 * 3 - 1, ..ReadOptions::default() };
    fs::remove_file(folder.path().join("1.png")).expect("written above");
    assert_eq!(code(read_clip(folder.path(), &options)), 2, "memory limit");
}

#[test]
fn deep_grey_and_transparent_files_become_8_bit_rgb() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("x.png");
    // 16 bits: 128 is one of 257 steps per 8-bit level, so 128 rounds down and 129 up.
    let deep = image::ImageBuffer::<image::Rgb<u16>, _>::from_raw(2, 1, vec![128, 129, 65535, 0, 257, 385]);
    deep.expect("6 samples").save(&path).expect("the folder is writable");
    assert_eq!(read_picture(&path, BLACK, &Ffmpeg::default()).expect("a PNG").rgb(), [0, 1, 255, 0, 1, 1]);

    let grey = image::GrayImage::from_raw(2, 1, vec![7, 200]).expect("2 samples");
    grey.save(&path).expect("the folder is writable");
    assert_eq!(read_picture(&path, BLACK, &Ffmpeg::default()).expect("a PNG").rgb(), [7, 7, 7, 200, 200, 200]);

    let clear = image::RgbaImage::from_raw(3, 1, vec![9, 9, 9, 255, 9, 9, 9, 0, 200, 100, 0, 51]).expect("12 samples");
    clear.save(&path).expect("the folder is writable");
    // 0.2 of the colour and 0.8 of white: 244, 224, 204.
    let laid = read_picture(&path, [255; 3], &Ffmpeg::default()).expect("a PNG");
    assert_eq!(laid.rgb(), [9, 9, 9, 255, 255, 255, 244, 224, 204]);
}

#[test]
fn jpeg_folders_are_read_in_natural_order() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..11).map(|t| smooth(48, 32, 7 * t)).collect();
    let input = pngs(folder.path(), &frames);
    let jpegs = folder.path().join("jpegs");
    fs::create_dir(&jpegs).expect("the folder is writable");
    // Numbers without leading zeros: in the order of the alphabet, frame_10 comes before frame_2.
    ffmpeg(&format!("-i {input} -q:v 1 -pix_fmt yuvj444p -start_number 0"), &jpegs.join("frame_%d.jpg"));
    fs::rename(jpegs.join("frame_3.jpg"), jpegs.join("frame_3.JPEG")).expect("the folder is writable");
    let clip = super::read(&jpegs);
    assert_eq!(clip.frames().len(), 11, "frames");
    // Measured 47 dB at that quality; the neighbouring frame, seven columns further, is at 26 dB.
    for (i, (got, want)) in clip.frames().iter().zip(&frames).enumerate() {
        let db = psnr(std::slice::from_ref(got), std::slice::from_ref(want));
        assert!(db > 38.0, "frame {i}: {db} dB");
    }
    fs::write(jpegs.join("frame_11.jpg"), b"no JPEG").expect("the folder is writable");
    let error = read_clip(&jpegs, &ReadOptions::default()).expect_err("no JPEG").to_string();
    assert!(error.contains("frame_11.jpg: picture") && error.contains("a readable JPEG"), "{error}");
}

#[test]
fn pictures_of_several_kinds_are_no_film() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let picture = Frame::new(2, 2, vec![9; 12]).expect("the length fits");
    write_png(&folder.path().join("0.png"), &picture).expect("the folder is writable");
    fs::write(folder.path().join("1.exr"), b"x").expect("the folder is writable");
    let error = list_pictures(folder.path()).expect_err("two kinds");
    let text = error.to_string();
    assert!(text.contains("frames: PNG and OpenEXR files") && text.contains("files of one kind"), "{text}");
    assert_eq!(code(Err::<(), _>(error)), 65, "exit code");
    fs::rename(folder.path().join("1.exr"), folder.path().join(".1.exr")).expect("the folder is writable");
    assert_eq!(list_pictures(folder.path()).expect("hidden files are not looked at").len(), 1, "pictures");
}
