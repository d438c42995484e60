//! Pictures are made smaller by what they cover, and compared by how they change.

use guard4d_engine::locate::gray::{Gray, correlation, correlation_where};
use guard4d_engine::media::Frame;

fn ramp(width: usize, height: usize) -> Gray {
    let value = |i: usize| (i % width) as f32 + 10.0 * (i / width) as f32;
    Gray { width, height, values: (0..width * height).map(value).collect() }
}

#[test]
fn smaller_pictures_are_means_of_what_they_cover() {
    let small = ramp(4, 4).resized(2, 2);
    assert_eq!(small.values, [5.5, 7.5, 25.5, 27.5]);
    // Three pixels into two: each covers one and a half.
    let uneven = Gray { width: 3, height: 1, values: vec![0.0, 3.0, 6.0] }.resized(2, 1);
    assert!(uneven.values.iter().zip([1.0, 5.0]).all(|(a, b): (&f32, f32)| (a - b).abs() < 1e-6), "{uneven:?}");
    let white = Gray::of_frame(&Frame::new(2, 1, vec![255; 6]).expect("a frame"));
    assert!(white.values.iter().all(|value| (value - 1.0).abs() < 1e-6), "{white:?}");
    assert_eq!(
        Gray::of_pixels(1, 1, &[9.0, 9.0, 9.0, 0.5]).values,
        Gray::of_pixels(1, 1, &[1.0, 1.0, 1.0, 0.0]).values
    );
}

#[test]
fn one_colour_is_told_from_the_faintest_picture() {
    let of = |levels: &[u8]| {
        let rgb = levels.iter().flat_map(|level| [*level; 3]).collect();
        Gray::of_frame(&Frame::new(levels.len() as u32, 1, rgb).expect("a frame"))
    };
    assert!(of(&[90, 90, 90, 90]).is_plain() && of(&[90, 92, 89, 91]).is_plain(), "as codecs leave it");
    assert!(!of(&[90, 90, 90, 99]).is_plain());
    let mut broken = of(&[90, 90, 90, 90]);
    broken.values[2] = f32::NAN;
    assert!(!broken.is_plain(), "what is no number is no colour");
}

#[test]
fn likeness_is_of_changes() {
    let picture = Gray { width: 3, height: 2, values: vec![0.0, 1.0, 0.5, 0.2, 0.9, 0.1] };
    let brighter = Gray { values: picture.values.iter().map(|v| 0.3 + 2.0 * v).collect(), ..picture.clone() };
    let inverted = Gray { values: picture.values.iter().map(|v| -v).collect(), ..picture.clone() };
    let flat = Gray { values: vec![0.7; 6], ..picture.clone() };
    // Sums of a dozen 32-bit numbers.
    assert!((correlation(&picture, &brighter) - 1.0).abs() < 1e-6);
    assert!((correlation(&picture, &inverted) + 1.0).abs() < 1e-6);
    assert_eq!(correlation(&picture, &flat), 0.0, "nothing to compare");
    assert_eq!(ramp(4, 3).slope()[0][5], 1.0);
    assert_eq!(ramp(4, 3).slope()[1][5], 10.0);
}

#[test]
fn likeness_of_a_part_does_not_see_the_rest() {
    let picture = Gray { width: 4, height: 1, values: vec![0.1, 0.9, 0.3, 0.3] };
    let with_logo = Gray { values: vec![0.1, 0.9, 0.3, -5.0], ..picture.clone() };
    assert!(correlation(&picture, &with_logo) < 0.3, "the whole sees it");
    // Sums of a few 32-bit numbers.
    assert!((correlation_where(&picture, &with_logo, |at| at < 2) - 1.0).abs() < 1e-6);
    assert_eq!(correlation_where(&picture, &with_logo, |_| false), 0.0, "nothing counts");
}

#[test]
fn the_least_nearby_spreads_right_left_up_and_down() {
    let mut picture = ramp(5, 4);
    picture.values.fill(1.0);
    picture.values[5 + 2] = 0.0;
    let near = picture.least_within(1);
    let low: Vec<usize> = (0..20).filter(|at| near.values[*at] == 0.0).collect();
    assert_eq!(low, [1, 2, 3, 6, 7, 8, 11, 12, 13]);
    assert_eq!(picture.least_within(9).values, [0.0; 20], "beyond all borders");
}
