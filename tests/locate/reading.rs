//! Of a film with bars, what is looked at is the picture between them.

use std::num::NonZeroU32;

use guard4d_engine::locate::picture::Picture;
use guard4d_engine::locate::reading::Reading;
use guard4d_engine::media::codec::Codec;
use guard4d_engine::media::encode::{EncodeOptions, write_video};
use guard4d_engine::media::framing::Rect;
use guard4d_engine::media::{Frame, ReadOptions};

#[test]
fn bars_are_cut_off_before_a_picture_is_made_smaller() {
    if !crate::support::has_ffmpeg() {
        return;
    }
    // Higher than what is looked at: no bar ends where a pixel of the smaller picture does.
    let (width, height, bar) = (300, 850, 101);
    let frames: Vec<Frame> = (0..4).map(|time| boxed(width, height, bar, time)).collect();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("film.mkv");
    let lossless = EncodeOptions { codec: Some(Codec::Ffv1), ..EncodeOptions::default() };
    write_video(&path, &frames, &lossless).unwrap_or_else(|error| panic!("{error}"));
    let mut read = 0;
    let reading = Reading::of(&path, &ReadOptions::default(), NonZeroU32::new(2).expect("two"), &mut || {
        read += 1;
        Ok(())
    });
    let reading = reading.unwrap_or_else(|error| panic!("{error}"));
    let picture = Rect { x: 0, y: bar, width, height: height - 2 * bar };
    assert_eq!((reading.picture, reading.frames, reading.every), (picture, 4, 2));
    let without: Vec<Picture> = [0, 2]
        .map(|at: usize| frames[at].cut(picture).expect("it is inside"))
        .map(|frame| Picture::of_frame(&frame, 768))
        .to_vec();
    assert!(reading.pictures == without, "as if there had been no bars");
    assert!(read >= 4, "each frame is told of");
}

/// A thing over black that is cut off below, within black bars: above it its own black goes on.
fn boxed(width: u32, height: u32, bar: u32, time: u32) -> Frame {
    let pixel = |at: u32| {
        let (x, y) = (at % width, at / width);
        let [across, down] = [x.abs_diff(150), y.abs_diff(height - bar - 60)];
        let is_in_it = across * across + down * down < 140 * 140 && y < height - bar;
        let levels = [x + time, y / 8, (x + y) % 97].map(|level| u8::try_from(80 + level % 160).expect("a level"));
        if is_in_it { levels } else { [0; 3] }
    };
    Frame::new(width, height, (0..width * height).flat_map(pixel).collect()).expect("the length fits")
}
