//! Video of 10 bits, video with transparency, and pictures other than PNG.

use std::fs;
use std::num::NonZeroU32;
use std::path::Path;

use guard4d_engine::media::ffmpeg::Ffmpeg;
use guard4d_engine::media::folder::{list_pictures, read_picture};
use guard4d_engine::media::frames::write_png;
use guard4d_engine::media::{Frame, ReadOptions, read_clip};

use super::{code, ffmpeg, psnr, read, smooth};

/// Frames as a folder of PNG files for ffmpeg.
fn pngs(folder: &Path, frames: &[Frame]) -> String {
    let pngs = folder.join("pngs");
    guard4d_engine::media::frames::write_png_folder(&pngs, frames).expect("the folder is writable");
    pngs.join("%05d.png").display().to_string()
}

#[test]
fn video_of_ten_bits_is_rounded_to_eight() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..4).map(|t| smooth(96, 64, t)).collect();
    let input = pngs(folder.path(), &frames);
    let to_video = "scale=out_color_matrix=bt709:out_range=tv:flags=accurate_rnd+full_chroma_int";
    // Measured 52 dB after H.265, 54 after VP9, and nothing lost without a lossy codec; another matrix leaves 29.
    for (name, arguments, least_db) in [
        ("h265.mkv", "-c:v libx265 -x265-params log-level=error -crf 8 -pix_fmt yuv420p10le", 48.0),
        ("yuv444.mkv", "-c:v ffv1 -pix_fmt yuv444p10le", 60.0),
        ("vp9.webm", "-c:v libvpx-vp9 -profile:v 2 -crf 8 -b:v 0 -pix_fmt yuv420p10le", 48.0),
    ] {
        let path = folder.path().join(name);
        let tags = "-colorspace bt709 -color_primaries bt709 -color_trc bt709 -color_range tv";
        ffmpeg(&format!("-i {input} -vf {to_video} {arguments} {tags}"), &path);
        let db = psnr(read(&path).frames(), &frames);
        assert!(db > least_db, "{name}: {db} dB");
    }
    // Levels of 8 bits lie 4 levels of 10 bits apart, so that they come back exactly if nothing adds noise.
    let path = folder.path().join("rgb.mkv");
    ffmpeg(&format!("-i {input} -c:v ffv1 -pix_fmt gbrp10le"), &path);
    let clip = read(&path);
    assert_eq!(clip.frames(), frames, "RGB of 10 bits");
}

#[test]
fn transparency_is_laid_over_the_background_in_every_codec_that_has_it() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    // Opaque on the left, clear on the right: 16-px halves, so that chroma of half resolution does not mix them.
    let source = "-f lavfi -i color=0xC8283C:s=64x32:d=0.3:r=10,format=rgba,geq=r='r(X,Y)':g='g(X,Y)':b='b(X,Y)':a='255*lt(X,32)'";
    // Lossless ones are off by nothing; VP9 goes through limited range and a codec.
    for (name, arguments, most) in [
        ("qtrle.mov", "-c:v qtrle -pix_fmt argb", 0),
        ("png.mov", "-c:v png -pix_fmt rgba", 0),
        ("ffv1.mkv", "-c:v ffv1 -pix_fmt bgra", 0),
        ("vp9.webm", "-c:v libvpx-vp9 -crf 4 -b:v 0 -pix_fmt yuva420p -auto-alt-ref 0", 6),
    ] {
        let path = folder.path().join(name);
        ffmpeg(&format!("{source} {arguments}"), &path);
        let options = ReadOptions { background: [10, 220, 30], ..ReadOptions::default() };
        let clip = read_clip(&path, &options).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!((clip.frames().len(), clip.size_px()), (3, (64, 32)), "{name}");
        let pixel = |x: usize| &clip.frames()[1].rgb()[3 * (16 * 64 + x)..][..3];
        for (x, want) in [(8, [200, 40, 60]), (56, [10, 220, 30])] {
            let off = pixel(x).iter().zip(want).map(|(got, want)| got.abs_diff(want)).max();
            assert!(off <= Some(most), "{name} at {x}: {:?}", pixel(x));
        }
    }
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
    let clip = read(&jpegs);
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
