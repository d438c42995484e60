//! Small pictures keep colours apart from brightness.

use guard4d_engine::locate::thumbnail::Thumbnail;
use guard4d_engine::media::Frame;

use crate::support::close::assert_close;

/// One pixel of a colour, as its channels.
fn channels(rgb: [u8; 3]) -> [f32; 3] {
    let frame = Frame::new(1, 1, rgb.to_vec()).expect("a frame");
    Thumbnail::of_frame(&frame).channels.map(|channel| channel.values[0])
}

#[test]
fn colours_of_one_brightness_differ_and_greys_have_none() {
    let [black, grey] = [channels([0; 3]), channels([128; 3])];
    // Rounding of some sums.
    assert!(black.iter().chain(&grey[1..]).all(|value| value.abs() < 1e-6), "{black:?} {grey:?}");
    assert!((grey[0] - 128.0 / 255.0).abs() < 1e-6, "{grey:?}");
    // 0.299 · 149 and 0.587 · 76 are the same but for a tenth of a level.
    let [red, green] = [channels([149, 0, 0]), channels([0, 76, 0])];
    assert!((red[0] - green[0]).abs() < 0.001, "as bright: {red:?} {green:?}");
    assert!(red[2] > 0.3 && green[2] < -0.1, "red and less than grey: {red:?} {green:?}");
    assert!(channels([0, 0, 149])[1] > 0.3, "blue");
}

#[test]
fn rendered_pixels_are_as_films_show_them() {
    let levels = [[255u8, 0, 0], [40, 90, 250], [255, 255, 255], [7, 8, 9]];
    let frame = Frame::new(4, 1, levels.concat()).expect("a frame");
    // What is brighter than white is white in a film.
    let pixels: Vec<f32> = levels
        .iter()
        .flat_map(|rgb| {
            rgb.map(|level| if level == 255 { 3.0 } else { f32::from(level) / 255.0 }).into_iter().chain([0.4])
        })
        .collect();
    let drawn = Thumbnail::of_pixels([4, 1], &pixels, [4, 1]);
    for (shown, drawn) in Thumbnail::of_frame(&frame).channels.iter().zip(&drawn.channels) {
        // Rounding of some sums.
        assert_close(&shown.values, &drawn.values, 1e-6, 0.0);
    }
    let halved = Thumbnail::of_pixels([4, 1], &pixels, [2, 1]);
    assert_eq!(halved.size(), [2, 1]);
    let mean = 0.5 * (drawn.channels[0].values[0] + drawn.channels[0].values[1]);
    assert!((halved.channels[0].values[0] - mean).abs() < 1e-6, "{halved:?}");
}
