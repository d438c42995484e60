//! Frames one after the other: which are read, how many are expected, and that no more than one is kept.

use std::fs;
use std::num::NonZeroU32;
use std::path::Path;

use guard4d_engine::error::EngineError;
use guard4d_engine::media::codec::Codec;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::framing::{Crop, Framing, Rect};
use guard4d_engine::media::png::write_png_folder;
use guard4d_engine::media::{Frame, FrameSource, ReadOptions, read_clip};

use super::{code, ffmpeg, smooth};

const FRAMES: usize = 23;

fn options(start: u32, every: u32, most: u32) -> ReadOptions {
    let every = NonZeroU32::new(every).expect("at least 1");
    ReadOptions { start, every, max_frames: NonZeroU32::new(most), ..ReadOptions::default() }
}

/// Checks every choice of frames of a lossless film against the frames themselves.
fn check(path: &Path, frames: &[Frame]) {
    for (start, every, most) in
        [(0, 1, 0), (5, 1, 0), (0, 4, 0), (3, 7, 0), (0, 1, 6), (2, 3, 4), (22, 1, 9), (0, 99, 0)]
    {
        let options = options(start, every, most);
        let most = if most == 0 { usize::MAX } else { most as usize };
        let want: Vec<_> = frames.iter().skip(start as usize).step_by(every as usize).take(most).cloned().collect();
        let what = format!("{}: {start}, {every}, {most}", path.display());
        assert_eq!(read_clip(path, &options).expect("a film").frames(), want, "{what}");
        let source = FrameSource::open(path, &options).expect("a film");
        assert_eq!(source.expected_frames(), Some(want.len() as u64), "{what}");
        assert_eq!(source.size_px().expect("a film"), (35, 21), "{what}");
        let ending = source.for_each(&mut |_| Ok(())).expect("a film");
        assert_eq!((ending.frames, ending.size_px), (want.len() as u64, (35, 21)), "{what}");
    }
    let error = read_clip(path, &options(23, 1, 0)).expect_err("beyond the end");
    let text = error.to_string();
    assert!(error.exit_code() == 65 && text.contains("frames: none from number 23 on"), "{text}");
}

#[test]
fn the_frames_that_are_asked_for_are_read() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..FRAMES as u32).map(|t| smooth(35, 21, 3 * t)).collect();
    let pngs = folder.path().join("pngs");
    write_png_folder(&pngs, &frames).expect("the folder is writable");
    check(&pngs, &frames);
    if !crate::support::has_ffmpeg() {
        return;
    }
    let video = folder.path().join("film.mkv");
    let options = EncodeOptions { codec: Some(Codec::Ffv1), ..EncodeOptions::default() };
    write_video(&video, &frames, &options).unwrap_or_else(|error| panic!("{error}"));
    check(&video, &frames);
}

#[test]
fn a_film_of_varying_rate_is_counted_by_its_frames() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("slow.mp4");
    ffmpeg("-f lavfi -i testsrc=s=64x32:r=10:d=2 -vf setpts=N*N/10/TB -fps_mode passthrough -pix_fmt yuv420p", &path);
    let all = read_clip(&path, &ReadOptions::default()).expect("a film");
    assert_eq!(all.frames().len(), 20, "frames");
    let some = read_clip(&path, &options(1, 6, 0)).expect("a film");
    let want: Vec<_> = all.frames().iter().skip(1).step_by(6).cloned().collect();
    assert_eq!(some.frames(), want, "one of six, whatever its time");
    assert_eq!(FrameSource::open(&path, &options(1, 6, 0)).expect("a film").expected_frames(), Some(4), "expected");
}

/// An hour of video, of which a few frames are read, and more than a clip may hold if they are taken one after the
/// other.
#[test]
fn long_films_pass_through_and_do_not_pile_up() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("hour.mp4");
    ffmpeg("-f lavfi -i color=0x305070:s=32x32:r=1:d=3600 -c:v libx264 -preset ultrafast -pix_fmt yuv420p", &path);
    let source = FrameSource::open(&path, &ReadOptions::default()).expect("a film");
    assert_eq!(source.expected_frames(), Some(3600), "frames");
    let ending = source.for_each(&mut |_| Ok(())).expect("a film");
    assert_eq!(ending.frames, 3600, "frames");
    let limited = ReadOptions { max_bytes: 100 * 32 * 32 * 3, ..ReadOptions::default() };
    let error = read_clip(&path, &limited).expect_err("3600 frames do not fit");
    assert!(error.exit_code() == 2 && error.to_string().contains("limit their number"), "{error}");
    assert_eq!(
        read_clip(&path, &ReadOptions { every: NonZeroU32::new(36).expect("not 0"), ..limited })
            .expect("100 fit")
            .frames()
            .len(),
        100,
        "frames"
    );

    let mut seen = 0;
    let stop = source.for_each(&mut |_| {
        seen += 1;
        if seen == 5 { Err(EngineError::Stopped) } else { Ok(()) }
    });
    assert!(matches!(stop, Err(EngineError::Stopped)) && seen == 5, "whoever takes the frames may stop");
}

#[test]
fn known_parts_are_cut_out_and_brought_to_size() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let frames: Vec<_> = (0..3).map(|t| smooth(40, 30, t)).collect();
    let pngs = folder.path().join("pngs");
    write_png_folder(&pngs, &frames).expect("the folder is writable");
    let with = |crop, size_px| ReadOptions { framing: Framing { crop, size_px }, ..ReadOptions::default() };
    let rect = Rect { x: 7, y: 4, width: 30, height: 25 };
    let clip = read_clip(&pngs, &with(Crop::Region(rect), None)).expect("a part");
    assert_eq!(clip.size_px(), (30, 25), "size");
    for (cut, whole) in clip.frames().iter().zip(&frames) {
        for (x, y) in [(0, 0), (29, 0), (0, 24), (29, 24), (11, 13)] {
            let at =
                |frame: &Frame, x: usize, y: usize| frame.rgb()[3 * (y * frame.width() as usize + x)..][..3].to_vec();
            assert_eq!(at(cut, x, y), at(whole, x + 7, y + 4), "({x}, {y})");
        }
    }
    let stretched = with(Crop::Region(rect), Some((60, 25)));
    let source = FrameSource::open(&pngs, &stretched).expect("a film");
    assert_eq!(source.size_px().expect("a film"), (60, 25), "as handed over");
    let ending = source.for_each(&mut |frame| {
        assert_eq!((frame.width(), frame.height()), (60, 25), "as handed over");
        Ok(())
    });
    assert_eq!(ending.expect("a film").size_px, (30, 25), "what there was to see does not grow");
    for rect in [Rect { x: 11, ..rect }, Rect { y: 6, ..rect }, Rect { x: u32::MAX, ..rect }] {
        let error = read_clip(&pngs, &with(Crop::Region(rect), None)).expect_err("it is not inside");
        assert!(error.exit_code() == 2 && error.to_string().contains("40 x 30 px"), "{error}");
    }
    for size in [(0, 8), (8, 0), (8, 16_385)] {
        assert_eq!(code(read_clip(&pngs, &with(Crop::Whole, Some(size)))), 2, "{size:?}");
    }
    assert!(fs::read_dir(&pngs).is_ok(), "reading leaves the film alone");
}

/// A film that was stretched comes back, but for what the resampling lost.
#[test]
fn stretching_is_undone() {
    let frame = smooth(96, 64, 0);
    let back = frame.resized((192, 64)).and_then(|wide| wide.resized((96, 64))).expect("sizes");
    // Rounding twice to 8 bits leaves 55 dB; a shift by half a pixel would leave 35 dB.
    let db = super::psnr(&[back], &[frame]);
    assert!(db > 50.0, "{db} dB");
}

#[test]
fn crops_are_written_as_four_numbers_or_auto() {
    assert_eq!("auto".parse(), Ok(Crop::Auto));
    assert_eq!("1,2,30,40".parse(), Ok(Crop::Region(Rect { x: 1, y: 2, width: 30, height: 40 })));
    for text in
        ["", "AUTO", "1,2,3", "1,2,3,4,5", "1,2,0,4", "1,2,3,0", "-1,2,3,4", "1,2,3,x", "1.5,2,3,4", "1,2,3,4294967296"]
    {
        assert!(text.parse::<Crop>().is_err_and(|error| error.contains("X,Y,W,H")), "`{text}`");
    }
}
