//! A frame keeps what says where it was taken, and a small picture in colour beside it.

use guard4d_engine::locate::picture::Picture;
use guard4d_engine::media::Frame;

#[test]
fn a_frame_and_its_small_picture_are_mirrored_together() {
    let (width, height) = (400, 200);
    // Red on the left, blue on the right; the upper half is brighter.
    let pixel = |at: u32| {
        let level = if at / width < height / 2 { 200 } else { 100 };
        if at % width < width / 2 { [level, 0, 0] } else { [0, 0, level] }
    };
    let frame = Frame::new(width, height, (0..width * height).flat_map(pixel).collect()).expect("a frame");
    let picture = Picture::of_frame(&frame, 300);
    assert_eq!([picture.gray.width, picture.gray.height], [300, 150], "sides of at most 300");
    let is_redder = |picture: &Picture, at: usize| picture.thumbnail.channels[2].values[at] > 0.0;
    assert!(is_redder(&picture, 0) && !is_redder(&picture.mirrored(), 0), "red is on the left, and then on the right");
    assert_eq!(picture.mirrored().mirrored(), picture);
}
