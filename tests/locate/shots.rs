//! Films are cut where pictures change at once, and pictures that come twice are known.

use guard4d_engine::locate::gray::Gray;
use guard4d_engine::locate::shots::{is_same, shots};

/// A pattern that has moved so many pixels: waves of this length across and down.
fn pattern(wave: f32, moved: f32) -> Gray {
    let (width, height) = (96, 64);
    let value = |i: usize| {
        let (x, y) = ((i % width) as f32 + moved, (i / width) as f32);
        0.5 + 0.2 * (x / wave).sin() + 0.2 * (y / (0.7 * wave)).cos() + 0.1 * ((x + 2.0 * y) / (0.3 * wave)).sin()
    };
    Gray { width, height, values: (0..width * height).map(value).collect() }
}

#[test]
fn a_film_is_cut_where_its_pictures_change_at_once() {
    let first = (0..6).map(|i| pattern(9.0, 0.8 * i as f32));
    let second = (0..4).map(|i| pattern(4.0, 0.5 * i as f32));
    let film: Vec<Gray> = first.chain(second).collect();
    assert_eq!(shots(film.iter()), [0..6, 6..10]);
    assert_eq!(shots(film[..6].iter()), vec![0..6], "movement is no cut");
    assert_eq!(shots(film[..1].iter()), vec![0..1]);
    assert!(shots([].iter()).is_empty());
    let flat = Gray { values: vec![0.3; 96 * 64], ..film[0].clone() };
    assert_eq!(
        shots([flat.clone(), flat].iter()).iter().map(ExactSizeIterator::len).sum::<usize>(),
        2,
        "each is in one"
    );
}

#[test]
fn a_picture_that_comes_twice_differs_by_coding_alone() {
    let picture = pattern(9.0, 0.0);
    let moved_by = |levels: f32| Gray {
        values: picture.values.iter().enumerate().map(|(i, v)| v + (i % 2) as f32 * levels / 255.0).collect(),
        ..picture.clone()
    };
    assert!(is_same(&picture, &picture) && is_same(&picture, &moved_by(1.0)));
    assert!(!is_same(&picture, &moved_by(3.0)));
}
