//! CIEDE2000 against published values, and what is said of many pixels.

use guard4d_engine::media::Frame;
use guard4d_engine::picture::colour_difference::{ColourDifference, difference, pixels_within};

#[test]
fn differences_are_the_published_ones() {
    let rgb = |rgb: [u8; 3]| rgb.map(|v| f32::from(v) / 255.0);
    let black_and_white = difference([0.0; 3], [1.0; 3]);
    assert!((black_and_white - 100.0).abs() < 1e-3, "of black and white, by the scale: {black_and_white}");
    assert!(difference([0.2, 0.5, 0.7], [0.2, 0.5, 0.7]).abs() < f32::EPSILON, "of a colour and itself");
    // The documentation of another implementation, `empfindung` 0.2.6; its white point and matrix are rounded
    // otherwise.
    let (red, blue) = (rgb([234, 76, 76]), rgb([76, 187, 234]));
    assert!((difference(red, blue) - 58.901_64).abs() < 0.02, "{}", difference(red, blue));
    assert!((difference(red, blue) - difference(blue, red)).abs() < 1e-4, "symmetric");
    let beyond = difference([-1.0, 0.5, 2.0], [0.0, 0.5, 1.0]);
    assert!(beyond.abs() < f32::EPSILON, "clamped: {beyond}");
}

#[test]
fn the_same_step_is_seen_more_easily_on_grey_than_on_orange() {
    let step = |[r, g, b]: [f32; 3]| difference([r, g, b], [r - 0.01, g + 0.01, b - 0.01]);
    let (grey, orange) = (step([0.5; 3]), step([0.85, 0.58, 0.15]));
    assert!(grey > 2.0 * orange, "{grey} and {orange}");
}

#[test]
fn pixels_of_the_object_count_and_others_do_not() {
    let frame = |rgb: Vec<u8>| Frame::new(2, 2, rgb).expect("four pixels");
    let clean = frame(vec![0; 12]);
    let mut rgb = vec![0; 12];
    rgb[3..6].fill(255);
    rgb[9..12].fill(255);
    let marked = frame(rgb);
    let within = |mask: &[bool]| pixels_within(&clean, &marked, mask);
    let all = within(&[true; 4]).expect("as many of each");
    assert!(all.iter().zip([0.0, 100.0, 0.0, 100.0]).all(|(d, want)| (d - want).abs() < 1e-3), "{all:?}");
    let some = within(&[true, true, false, false]).expect("as many of each");
    assert_eq!(some.len(), 2, "inside the mask: {some:?}");
    assert!(within(&[true; 3]).is_err(), "mask of another size");
}

#[test]
fn one_pixel_in_twenty_is_above() {
    let of = ColourDifference::of((0..=100u8).rev().map(f32::from).collect()).expect("pixels");
    assert_eq!((of.mean, of.p95), (50.0, 95.0));
    assert_eq!(ColourDifference::of(Vec::new()), None, "of nothing");
    let poisoned = ColourDifference::of(vec![1.0, f32::NAN]).expect("pixels");
    assert!(poisoned.mean.is_nan(), "NaN shows: {poisoned:?}");
}
