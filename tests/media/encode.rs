//! Video as the ffmpeg program writes it for us.

use std::fs;
use std::num::NonZeroU32;
use std::process::Command;

use guard4d_engine::media::encode::{EncodeOptions, OddSize, VideoWriter, write_video};
use guard4d_engine::media::ffmpeg::Ffmpeg;
use guard4d_engine::media::{Frame, Integrity, ReadOptions, read_clip};

use super::{code, psnr, read, smooth, written};

#[test]
fn mp4_keeps_frames_size_rate_and_colour() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..8).map(|t| smooth(96, 64, t)).collect();
    let path = written(folder.path(), &frames, &EncodeOptions::default());
    let clip = read(&path);
    assert_eq!((clip.frames().len(), clip.size_px()), (8, (96, 64)));
    assert_eq!(clip.integrity(), &Integrity::Intact);
    let rate = clip.frame_rate().expect("mp4 declares a rate");
    assert_eq!((rate.frames.get(), rate.seconds.get()), (30, 1));
    // Measured 46.4 dB; a wrong matrix or range gives 29 dB.
    assert!(psnr(clip.frames(), &frames) > 42.0, "{} dB", psnr(clip.frames(), &frames));

    let options = ReadOptions { max_frames: NonZeroU32::new(3), ..ReadOptions::default() };
    let start = read_clip(&path, &options).expect("a sound file");
    assert_eq!(start.frames(), &clip.frames()[..3]);
    assert_eq!(code(write_video(&path, &frames, &EncodeOptions::default())), 73, "it exists");
}

#[test]
fn mp4_is_tagged_bt709_limited_with_the_index_first() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = written(folder.path(), &[smooth(32, 32, 0)], &EncodeOptions::default());
    let probe = Command::new("ffprobe")
        .args(["-v", "error", "-of", "default=nw=1:nk=1", "-show_entries"])
        .arg("stream=codec_name,pix_fmt,color_range,color_space,color_transfer,color_primaries")
        .arg(&path)
        .output()
        .expect("ffprobe comes with ffmpeg");
    let tags = String::from_utf8_lossy(&probe.stdout);
    let tags: Vec<_> = tags.split_whitespace().collect();
    assert_eq!(tags, ["h264", "yuv420p", "tv", "bt709", "bt709", "bt709"]);
    let bytes = fs::read(&path).expect("written above");
    let at = |name: &[u8]| bytes.windows(4).position(|w| w == name).expect("every mp4 has it");
    assert!(at(b"moov") < at(b"mdat"), "faststart");
    assert_eq!(read(&path).frames().len(), 1, "one frame is a clip; whether it suffices is the verifier's business");
}

#[test]
fn black_white_and_grey_keep_their_levels() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let flat = |level: u8| Frame::new(32, 32, vec![level; 32 * 32 * 3]).expect("the length fits");
    let frames = [flat(0), flat(255), flat(128), flat(1)];
    let path = written(folder.path(), &frames, &EncodeOptions { crf: Some(1), ..EncodeOptions::default() });
    for (got, want) in read(&path).frames().iter().zip(&frames) {
        // Limited range has 220 levels for 256: half a step of 1.16, and one of the codec.
        let worst = got.rgb().iter().zip(want.rgb()).map(|(g, w)| g.abs_diff(*w)).max();
        assert!(worst <= Some(2), "level {}: {worst:?} off", want.rgb()[0]);
    }
}

#[test]
fn odd_sizes_are_refused_or_extended() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("odd.mp4");
    let frames = [smooth(35, 21, 0), smooth(35, 21, 1)];
    let error = write_video(&path, &frames, &EncodeOptions::default()).expect_err("odd").to_string();
    assert!(error.contains("35 x 21") && error.contains("PNG folder"), "{error}");
    let options = EncodeOptions { odd_size: OddSize::Extend, ..EncodeOptions::default() };
    write_video(&path, &frames, &options).expect("extended to even sizes");
    assert_eq!(read(&path).size_px(), (36, 22));
}

#[test]
fn refused_and_unfinished_videos_leave_no_file() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let options = EncodeOptions::default();
    let path = folder.path().join("x.mp4");
    assert_eq!(code(write_video(&path, &[], &options)), 2, "no frames");
    assert_eq!(code(write_video(&path, &[smooth(8, 8, 0), smooth(8, 10, 0)], &options)), 2, "two sizes");
    assert_eq!(code(write_video(&path, &[smooth(8, 8, 0)], &EncodeOptions { crf: Some(52), ..options.clone() })), 2);
    let file = folder.path().join("file");
    fs::write(&file, "x").expect("the folder is writable");
    assert_eq!(code(write_video(&file.join("x.mp4"), &[smooth(8, 8, 0)], &options)), 73, "below a file");
    let mut writer = VideoWriter::start(&path, (8, 8), &options).expect("an encoder");
    writer.push(&smooth(8, 8, 0)).expect("it runs");
    drop(writer);
    let names: Vec<_> = fs::read_dir(folder.path()).expect("a folder").map(|e| e.expect("an entry").path()).collect();
    assert_eq!(names, [file], "an unfinished file was left");
}

#[test]
fn a_missing_program_is_named_with_a_way_out() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let absent = Ffmpeg { ffmpeg: "/nowhere/ffmpeg".into(), ffprobe: "/nowhere/ffprobe".into() };
    let path = folder.path().join("x.mp4");
    let options = EncodeOptions { ffmpeg: absent.clone(), ..EncodeOptions::default() };
    let error = write_video(&path, &[smooth(8, 8, 0)], &options).expect_err("no program");
    assert_eq!(error.exit_code(), 69);
    assert!(error.to_string().contains("GUARD4D_FFMPEG"), "{error}");
    assert!(!path.exists(), "a claimed place was left behind");
    fs::write(&path, "x").expect("the folder is writable");
    let options = ReadOptions { ffmpeg: absent, ..ReadOptions::default() };
    assert_eq!(code(read_clip(&path, &options)), 69);
}
