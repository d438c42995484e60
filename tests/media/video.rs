//! Video through the ffmpeg program.

use std::fs;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::process::Command;

use guard4d_engine::media::encode::{EncodeOptions, OddSize, VideoWriter, write_video};
use guard4d_engine::media::ffmpeg::Ffmpeg;
use guard4d_engine::media::frames::write_png_folder;
use guard4d_engine::media::{Frame, Integrity, ReadOptions, read_clip};

use super::{code, ffmpeg, psnr, read, smooth};

fn written(folder: &Path, frames: &[Frame], options: &EncodeOptions) -> PathBuf {
    let path = folder.join("clip.mp4");
    write_video(&path, frames, options).unwrap_or_else(|error| panic!("{error}"));
    path
}

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
fn range_and_matrix_tags_are_honoured() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let want = [200_u8, 40, 60];
    for (matrix, range) in
        [("bt709", "tv"), ("smpte170m", "tv"), ("bt470bg", "pc"), ("bt2020nc", "tv"), ("bt709", "pc")]
    {
        let path = folder.path().join(format!("{matrix}_{range}.mkv"));
        let name = match matrix {
            "bt470bg" => "bt470",
            "bt2020nc" => "bt2020",
            same => same,
        };
        let words = format!(
            "-f lavfi -i color=0xC8283C:s=64x64:d=0.2:r=10,format=rgb24 \
             -vf scale=out_color_matrix={name}:out_range={range},format=yuv444p -c:v ffv1 -colorspace {matrix} -color_range {range}"
        );
        ffmpeg(&words, &path);
        let clip = read(&path);
        // Three roundings of at most one level each; BT.601 for BT.709 moves green by 17.
        let close = |p: &[u8]| p.iter().zip(want).all(|(&g, w)| g.abs_diff(w) <= 3);
        assert!(clip.frames()[0].rgb().chunks(3).all(close), "{matrix} {range}: {:?}", &clip.frames()[0].rgb()[..3]);
    }
}

#[test]
fn untagged_video_is_bt601_below_720_lines_and_bt709_from_there() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (size, matrix) in [("64x64", "smpte170m"), ("64x720", "bt709")] {
        let path = folder.path().join("untagged.y4m");
        let words = format!(
            "-f lavfi -i color=0xC8283C:s={size}:d=0.1:r=10,format=rgb24 \
             -vf scale=out_color_matrix={matrix}:out_range=tv,format=yuv420p -f yuv4mpegpipe"
        );
        ffmpeg(&words, &path);
        let clip = read(&path);
        let got = &clip.frames()[0].rgb()[..3];
        // As above.
        assert!(got.iter().zip([200_u8, 40, 60]).all(|(g, w)| g.abs_diff(w) <= 3), "{size}: {got:?}");
    }
}

#[test]
fn lossless_video_and_png_folder_hash_alike() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..3).map(|t| smooth(33, 17, t)).collect();
    let pngs = folder.path().join("pngs");
    write_png_folder(&pngs, &frames).expect("the folder is writable");
    let video = folder.path().join("lossless.mkv");
    ffmpeg(&format!("-i {}/%05d.png -c:v ffv1 -pix_fmt bgr0", pngs.display()), &video);
    assert_eq!(read(&video).digest(), read(&pngs).digest());
    assert_eq!(read(&video).size_px(), (33, 17));
}

#[test]
fn variable_frame_rate_and_rotation_are_taken_as_stored() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [plain, slow, turned] = ["p.mp4", "slow.mp4", "turned.mp4"].map(|name| folder.path().join(name));
    ffmpeg("-f lavfi -i testsrc=s=64x32:r=10:d=1 -pix_fmt yuv420p", &plain);
    let input = plain.display();
    ffmpeg(&format!("-i {input} -vf setpts=N*N/10/TB -fps_mode passthrough -pix_fmt yuv420p"), &slow);
    assert_eq!(read(&slow).frames().len(), 10, "no frame is repeated to fill gaps");

    // From version 6 on, ffmpeg writes what its input option says, and no longer what the old tag says.
    let old = Command::new("ffmpeg").arg("-version").output().expect("has_ffmpeg was asked");
    let version = String::from_utf8_lossy(&old.stdout);
    let major: u32 = version.split(|c: char| !c.is_ascii_digit()).find_map(|n| n.parse().ok()).expect("a version");
    match major {
        ..6 => ffmpeg(&format!("-i {input} -c copy -metadata:s:v rotate=90"), &turned),
        _ => ffmpeg(&format!("-display_rotation 90 -i {input} -c copy"), &turned),
    }
    let (plain, turned) = (read(&plain), read(&turned));
    assert_eq!(turned.size_px(), (32, 64), "upright");
    // Against the clock: the right column becomes the upper row.
    let turn = |frame: &Frame| {
        let at = |x: usize, y: usize| frame.rgb()[3 * (y * 64 + x)..][..3].to_vec();
        let rows = (0..64).flat_map(|y| (0..32).map(move |x| (63 - y, x)));
        Frame::new(32, 64, rows.flat_map(|(x, y)| at(x, y)).collect()).expect("the length fits")
    };
    let want: Vec<_> = plain.frames().iter().map(turn).collect();
    // Chroma is enlarged after turning, which this coarse picture shows; turned otherwise, it is at 2 dB.
    let db = psnr(turned.frames(), &want);
    assert!(db > 25.0, "{db} dB");
}

#[test]
fn transparency_is_laid_over_the_background() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("clear.mkv");
    ffmpeg("-f lavfi -i color=red@0.0:s=16x16:d=0.1:r=10,format=rgba -c:v ffv1 -pix_fmt bgra", &path);
    let options = ReadOptions { background: [10, 20, 30], ..ReadOptions::default() };
    let clip = read_clip(&path, &options).expect("a sound file");
    assert_eq!(clip.frames()[0].rgb()[..3], [10, 20, 30]);
}

#[test]
fn corrupt_and_strange_files_are_refused_and_damage_is_told() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..30).map(|t| smooth(96, 64, 5 * t)).collect();
    let path = written(folder.path(), &frames, &EncodeOptions::default());
    let whole = fs::read(&path).expect("written above");
    let bad = folder.path().join("bad.mp4");
    let refuse = |bytes: &[u8]| {
        fs::write(&bad, bytes).expect("the folder is writable");
        code(read_clip(&bad, &ReadOptions::default()))
    };
    assert_eq!(refuse(b""), 65, "empty");
    assert_eq!(refuse(b"this is no video at all, only words and words"), 65, "text");
    assert_eq!(refuse(&whole[..200]), 65, "cut in the index");
    assert_eq!(code(read_clip(&folder.path().join("nowhere.mp4"), &ReadOptions::default())), 66);

    fs::write(&bad, &whole[..whole.len() * 3 / 4]).expect("the folder is writable");
    let cut = read(&bad);
    assert!(
        matches!(cut.integrity(), Integrity::Damaged { messages } if !messages.is_empty()),
        "{:?}",
        cut.integrity()
    );
    assert!(cut.frames().len() < 30, "{} frames", cut.frames().len());

    let sound = folder.path().join("sound.mp4");
    ffmpeg("-f lavfi -i anullsrc=d=0.1", &sound);
    assert_eq!(code(read_clip(&sound, &ReadOptions::default())), 65, "no video stream");
    let playlist = folder.path().join("list.mp4");
    fs::write(&playlist, "#EXTM3U\n#EXTINF:1,\nhttp://example.invalid/x.ts\n").expect("the folder is writable");
    assert_eq!(code(read_clip(&playlist, &ReadOptions::default())), 65, "a playlist reaches no other place");
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
