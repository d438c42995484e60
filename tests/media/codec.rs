//! Films in every codec and container.

use std::process::Command;

use guard4d_engine::media::Integrity;
use guard4d_engine::media::codec::{Codec, Container};
use guard4d_engine::media::encode::{EncodeOptions, OddSize, write_video};
use guard4d_engine::media::ffmpeg::Ffmpeg;

use super::{code, psnr, read, smooth};

fn options(codec: Codec) -> EncodeOptions {
    EncodeOptions { codec: Some(codec), ..EncodeOptions::default() }
}

/// Words of ffprobe about the video stream.
fn tags(path: &std::path::Path) -> Vec<String> {
    let probe = Command::new("ffprobe")
        .args(["-v", "error", "-of", "default=nw=1:nk=1", "-show_entries"])
        .arg("stream=codec_name,pix_fmt,color_range,color_space,color_transfer,color_primaries")
        .arg(path)
        .output()
        .expect("ffprobe comes with ffmpeg");
    String::from_utf8_lossy(&probe.stdout).split_whitespace().map(str::to_owned).collect()
}

#[test]
fn every_codec_keeps_frames_and_colours_in_every_container_that_holds_it() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..6).map(|t| smooth(96, 64, t)).collect();
    for container in ["mp4", "mov", "mkv", "webm"] {
        let path = folder.path().join(format!("film.{container}"));
        for &codec in Container::of(&path).expect("a video's extension").codecs() {
            let path = folder.path().join(format!("{codec}.{container}"));
            write_video(&path, &frames, &options(codec)).unwrap_or_else(|error| panic!("{error}"));
            let clip = read(&path);
            assert_eq!((clip.frames().len(), clip.size_px()), (6, (96, 64)), "{codec} in {container}");
            assert_eq!(clip.integrity(), &Integrity::Intact, "{codec} in {container}");
            let rate = clip.frame_rate().expect("a rate is declared");
            assert_eq!((rate.frames.get(), rate.seconds.get()), (30, 1), "{codec} in {container}");
            if codec.is_lossless() {
                assert_eq!(clip.frames(), frames, "{codec} in {container}");
                continue;
            }
            // Chroma of half resolution and limited range alone leave 52 dB, the codecs 46 to 48; a wrong matrix or
            // range leaves 29 dB.
            let db = psnr(clip.frames(), &frames);
            assert!(db > 42.0, "{codec} in {container}: {db} dB");
            let name = if codec == Codec::H265 { "hevc" } else { codec.name() };
            assert_eq!(tags(&path), [name, "yuv420p", "tv", "bt709", "bt709", "bt709"], "{codec} in {container}");
        }
    }
}

#[test]
fn the_extension_says_which_codec_unless_it_is_named() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (name, codec) in [("a.MP4", "h264"), ("a.mov", "h264"), ("a.mkv", "h264"), ("a.webm", "vp9")] {
        let path = folder.path().join(name);
        write_video(&path, &[smooth(16, 16, 0)], &EncodeOptions::default()).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(tags(&path)[0], codec, "{name}");
    }
}

#[test]
fn lossless_video_holds_odd_sizes_and_every_level() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("odd.mkv");
    // Every level of every channel, and neighbours that differ as much as levels can.
    let sample = |i: u32, t: u32| ((i * 97 + t * 31 + i * i % 251) % 256) as u8;
    let noisy = |t| (0..3 * 35 * 21).map(|i| sample(i, t)).collect();
    let frames: Vec<_> =
        (0..3).map(|t| guard4d_engine::media::Frame::new(35, 21, noisy(t)).expect("the length fits")).collect();
    for odd_size in [OddSize::Refuse, OddSize::Extend] {
        let options = EncodeOptions {
            odd_size,
            existing: guard4d_engine::base::output::Existing::Replace,
            ..options(Codec::Ffv1)
        };
        write_video(&path, &frames, &options).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(read(&path).frames(), frames, "{odd_size:?}");
    }
}

#[test]
fn codecs_containers_and_factors_must_fit_together() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let refused = |name: &str, options: &EncodeOptions, words: &[&str]| {
        let error = write_video(&folder.path().join(name), &[smooth(16, 16, 0)], options).expect_err("it does not fit");
        assert_eq!(error.exit_code(), 2, "{error}");
        let text = error.to_string();
        assert!(words.iter().all(|word| text.contains(word)), "{words:?} in {text}");
    };
    refused("a.mp4", &options(Codec::Ffv1), &["codec: ffv1", "h264, h265, av1, vp9 in .mp4", ".mkv holds all"]);
    refused("a.webm", &options(Codec::H264), &["codec: h264", "vp9, av1 in .webm"]);
    refused("a.mov", &options(Codec::Av1), &["codec: av1", "h264, h265 in .mov"]);
    refused("a.avi", &options(Codec::H264), &["a.avi", ".mp4, .mov, .mkv or .webm"]);
    let with = |codec, crf| EncodeOptions { crf: Some(crf), ..options(codec) };
    refused("a.mkv", &with(Codec::Ffv1, 0), &["crf: 0", "ffv1 loses nothing"]);
    for (codec, max) in [(Codec::H264, 51), (Codec::H265, 51), (Codec::Av1, 63), (Codec::Vp9, 63)] {
        refused("a.mkv", &with(codec, max + 1), &[&format!("0 to {max} for {codec}")]);
    }
    assert_eq!(crate::support::names(folder.path()), [""; 0], "nothing is left");
    for codec in Codec::ALL {
        assert_eq!(codec.name().parse(), Ok(codec), "{codec}");
    }
    assert!("H264".parse::<Codec>().is_err_and(|text| text.contains("h264, h265, av1, vp9, ffv1")), "names are listed");
}

#[test]
fn an_ffmpeg_without_the_encoder_is_told_from_one_that_is_missing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.mkv");
    // A program that ends well and lists nothing.
    let ffmpeg = Ffmpeg { ffmpeg: "true".into(), ffprobe: "true".into() };
    for (codec, encoder) in [(Codec::Av1, "libaom-av1 or libsvtav1"), (Codec::H265, "libx265"), (Codec::Ffv1, "ffv1")] {
        let options = EncodeOptions { ffmpeg: ffmpeg.clone(), ..options(codec) };
        let error = write_video(&path, &[smooth(16, 16, 0)], &options).expect_err("no encoder");
        let text = error.to_string();
        assert!(text.contains(&format!("no encoder for {codec} ({encoder})")), "{text}");
        assert_eq!(code(Err::<(), _>(error)), 69, "{codec}");
    }
    assert_eq!(crate::support::names(folder.path()), [""; 0], "nothing is left");
}
