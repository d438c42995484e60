//! Bars around pictures: found exactly, and never where there are none.

use std::path::Path;

use guard4d_engine::media::codec::Codec;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::framing::{BarFinder, Crop, Framing, Rect};
use guard4d_engine::media::{Frame, FrameSource, ReadOptions};

use super::smooth;

/// Frames of `size`, black but for `picture` at `rect`.
fn framed(size: (u32, u32), rect: Rect, bar: [u8; 3], picture: impl Fn(u32, u32) -> [u8; 3]) -> Frame {
    let pixel = |i: u32| {
        let (x, y) = (i % size.0, i / size.0);
        let inside = (rect.x..rect.x + rect.width).contains(&x) && (rect.y..rect.y + rect.height).contains(&y);
        if inside { picture(x - rect.x, y - rect.y) } else { bar }
    };
    Frame::new(size.0, size.1, (0..size.0 * size.1).flat_map(pixel).collect()).expect("the length fits")
}

/// A moving picture inside bars.
fn film(size: (u32, u32), rect: Rect, bar: [u8; 3]) -> Vec<Frame> {
    let inside = |frame: &Frame, x: u32, y: u32| {
        let at = 3 * (y * frame.width() + x) as usize;
        [frame.rgb()[at], frame.rgb()[at + 1], frame.rgb()[at + 2]]
    };
    let pictures = (0..12).map(|t| smooth(rect.width, rect.height, 9 * t));
    pictures.map(|picture| framed(size, rect, bar, |x, y| inside(&picture, x, y))).collect()
}

fn found(frames: &[Frame]) -> Option<Rect> {
    let mut finder = BarFinder::default();
    frames.iter().for_each(|frame| finder.look(frame));
    finder.find()
}

/// Letterbox, pillarbox and both; odd places and sizes; bars that differ by two lines.
const RECTS: [Rect; 5] = [
    Rect { x: 0, y: 20, width: 160, height: 80 },
    Rect { x: 31, y: 0, width: 98, height: 120 },
    Rect { x: 0, y: 17, width: 160, height: 87 },
    Rect { x: 16, y: 12, width: 128, height: 96 },
    Rect { x: 0, y: 10, width: 160, height: 98 },
];
const SIZE: (u32, u32) = (160, 120);

#[test]
fn bars_of_any_colour_are_found_to_the_line() {
    for rect in RECTS {
        for bar in [[0; 3], [255; 3], [16; 3], [0, 0, 90]] {
            assert_eq!(found(&film(SIZE, rect, bar)), Some(rect), "{bar:?}");
        }
    }
}

/// What a codec adds to bars: noise, ringing next to the picture, and chroma that bleeds over the edge.
#[test]
fn bars_are_found_to_the_line_after_every_codec() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    // crf as videos of the web have it, and worse.
    for (codec, crf) in [(Codec::H264, 23), (Codec::H264, 32), (Codec::H265, 28), (Codec::Vp9, 36), (Codec::Av1, 36)] {
        for (i, rect) in RECTS.into_iter().enumerate() {
            let path = folder.path().join(format!("{codec}-{crf}-{i}.mkv"));
            let options = EncodeOptions { codec: Some(codec), crf: Some(crf), ..EncodeOptions::default() };
            write_video(&path, &film(SIZE, rect, [0; 3]), &options).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(detected(&path), Some(rect), "{codec} {crf}");
        }
    }
}

fn detected(path: &Path) -> Option<Rect> {
    let framing = Framing { crop: Crop::Auto, size_px: None };
    let source = FrameSource::open(path, &ReadOptions { framing, ..ReadOptions::default() }).expect("a film");
    let ending = source.for_each(&mut |_| Ok(())).expect("a film");
    let Rect { width, height, .. } = source.cut().unwrap_or(Rect { x: 0, y: 0, width: SIZE.0, height: SIZE.1 });
    assert_eq!(ending.size_px, (width, height), "frames are cut to what was found");
    source.cut()
}

/// The picture fades in from black, and its outermost lines are dark in most frames: the bright ones tell.
#[test]
fn a_film_that_fades_in_keeps_its_dark_edges() {
    let rect = RECTS[0];
    let fading = (0..12).map(|t| framed(SIZE, rect, [0; 3], |x, y| [(t * (8 + (x + y) % 5)) as u8; 3]));
    let frames: Vec<_> = fading.collect();
    assert_eq!(found(&frames), Some(rect), "the last frames have levels of 88 and more");
    assert_eq!(found(&frames[..2]), None, "levels of up to 12 are no edge; what is not sure is not cut off");
    assert_eq!(found(&frames[..1]), None, "black alone");
}

#[test]
fn what_is_no_bar_is_left_alone() {
    let whole = Rect { x: 0, y: 0, width: SIZE.0, height: SIZE.1 };
    assert_eq!(found(&film(SIZE, whole, [0; 3])), None, "no bars");
    // A ball over black, as splats are rendered: black on all sides in equal widths, but with a round edge.
    let ball = |cx: i32, cy: i32, r: i32| {
        framed(SIZE, whole, [0; 3], move |x, y| {
            let (dx, dy) = (x as i32 - cx, y as i32 - cy);
            if dx * dx + dy * dy < r * r { [180, 120, 90] } else { [0; 3] }
        })
    };
    assert_eq!(found(&[ball(80, 60, 30), ball(80, 60, 45)]), None, "a ball in the middle");
    assert_eq!(found(&[ball(80, 60, 70)]), None, "a ball that touches the frame above and below");
    // A box over black on one side: a straight edge, but no bars of equal widths.
    let side = Rect { x: 20, y: 30, width: 100, height: 60 };
    assert_eq!(found(&[framed(SIZE, Rect { y: 50, ..side }, [0; 3], |_, _| [200; 3])]), None, "off the middle");
    // Black sky above a straight horizon.
    let ground = Rect { x: 0, y: 50, width: 160, height: 70 };
    assert_eq!(found(&film(SIZE, ground, [0; 3])), None, "one bar is none");
    // Subtitles in a bar, in one frame.
    let mut frames = film(SIZE, RECTS[0], [0; 3]);
    let title = Rect { x: 60, y: 106, width: 40, height: 6 };
    let written: Vec<u8> = (0..SIZE.0 * SIZE.1)
        .flat_map(|i| {
            let (x, y) = (i % SIZE.0, i / SIZE.0);
            let inside =
                (title.x..title.x + title.width).contains(&x) && (title.y..title.y + title.height).contains(&y);
            let at = 3 * i as usize;
            if inside { [255; 3] } else { [0, 1, 2].map(|c| frames[5].rgb()[at + c]) }
        })
        .collect();
    frames[5] = Frame::new(SIZE.0, SIZE.1, written).expect("the length fits");
    assert_eq!(found(&frames), None, "bars with subtitles have to be named");
    assert_eq!(found(&frames[..5]), Some(RECTS[0]), "without them they are found");
    // Dark borders of a picture: a vignette fades, it has no edge.
    let vignette = framed(SIZE, whole, [0; 3], |x, y| {
        let near = |at: u32, side: u32| at.min(side - 1 - at).min(40);
        [(near(x, SIZE.0) * near(y, SIZE.1) / 16) as u8; 3]
    });
    assert_eq!(found(&[vignette]), None, "a vignette");
    for level in [0, 255, 128] {
        let flat = Frame::new(SIZE.0, SIZE.1, vec![level; (3 * SIZE.0 * SIZE.1) as usize]).expect("the length fits");
        assert_eq!(found(&[flat]), None, "one colour has no picture");
    }
    let dot = Frame::new(1, 1, vec![3; 3]).expect("the length fits");
    assert_eq!(found(&[dot]), None, "a single pixel");
    assert_eq!(found(&[]), None, "no frame");
}

/// Bars of one height leave the middle; what a thing over black shows of them is where it is cut off.
#[test]
fn what_is_cut_off_straight_on_one_side_tells_of_bars_on_both() {
    let middle = |frames: &[Frame]| {
        let mut finder = BarFinder::default();
        frames.iter().for_each(|frame| finder.look(frame));
        finder.middle()
    };
    let whole = Rect { x: 0, y: 0, width: SIZE.0, height: SIZE.1 };
    for (rect, expected) in [
        (RECTS[0], RECTS[0]),
        (RECTS[2], Rect { y: 16, height: 88, ..RECTS[2] }),
        (RECTS[3], RECTS[3]),
        (RECTS[4], Rect { height: 100, ..RECTS[4] }),
    ] {
        assert_eq!(middle(&film(SIZE, rect, [0; 3])), Some(expected), "as high as the lower of two");
    }
    // A ball over black within black bars.
    let ball = |bar: u32, cy: i32, r: i32| {
        let rect = Rect { x: 0, y: bar, width: SIZE.0, height: SIZE.1 - 2 * bar };
        framed(SIZE, rect, [0; 3], move |x, y| {
            let (dx, dy) = (x as i32 - 80, y as i32 - cy);
            if dx * dx + dy * dy < r * r { [180, 120, 90] } else { [0; 3] }
        })
    };
    let between = Rect { x: 0, y: 14, width: 160, height: 92 };
    assert_eq!(middle(&[ball(14, 70, 40)]), Some(between), "cut off below alone");
    assert_eq!(middle(&[ball(14, 20, 40)]), Some(between), "cut off above alone");
    assert_eq!(middle(&[ball(14, 46, 30), ball(14, 75, 30)]), Some(between), "cut off in one frame of two");
    // Above it begins too dark to be sure of, as high as it is cut off below.
    let rect = Rect { x: 0, y: 14, width: 160, height: 92 };
    let rising = framed(SIZE, rect, [0; 3], |_, y| [(6 + 2 * y.min(90)) as u8; 3]);
    assert_eq!(middle(&[rising]), Some(between), "cut off below, dark above");
    // Where nothing is cut off nothing can tell, and bars do no harm.
    for cy in [40, 46, 52] {
        assert_eq!(middle(&[ball(14, cy, 30)]), Some(whole), "whole, {cy}");
    }
    assert_eq!(middle(&[ball(0, 60, 30)]), Some(whole), "no bars");
    assert_eq!(middle(&[ball(0, 100, 40)]), Some(whole), "no bars, and cut off by the frame");
    let flat = Frame::new(SIZE.0, SIZE.1, vec![7; (3 * SIZE.0 * SIZE.1) as usize]).expect("the length fits");
    assert_eq!(middle(&[flat]), Some(whole), "one colour");
    assert_eq!(middle(&[]), None, "no frame");
}
