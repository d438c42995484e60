//! PSNR and SSIM against an independent implementation and against theory.

use guard4d_engine::media::Frame;
use guard4d_engine::picture::metrics::{Decibels, Picture, PsnrSummary, SquaredError, foreground, ssim};

const WIDTH: u32 = 23;
const HEIGHT: u32 = 17;

fn frame(sample: impl Fn(u32, u32, u32) -> u32) -> Frame {
    let index = (0..HEIGHT).flat_map(|y| (0..WIDTH).flat_map(move |x| (0..3).map(move |c| (x, y, c))));
    let rgb = index.map(|(x, y, c)| (sample(x, y, c) % 256) as u8).collect();
    Frame::new(WIDTH, HEIGHT, rgb).expect("the length fits")
}

fn first() -> Frame {
    frame(|x, y, c| x * 7 + y * 13 + c * 29)
}

fn second() -> Frame {
    frame(|x, y, c| x * 11 + y * 5 + c * 17)
}

fn similarity(a: &Frame, b: &Frame) -> f64 {
    ssim(&Picture::from_frame(a), &Picture::from_frame(b)).expect("equal sizes")
}

fn error(a: &Frame, b: &Frame) -> SquaredError {
    SquaredError::between(&Picture::from_frame(a), &Picture::from_frame(b)).expect("equal sizes")
}

/// Reference: PyTorch 2.15 in f64, `conv2d` with the outer product of the window, padding 5, on the same pictures.
#[test]
fn ssim_agrees_with_a_direct_convolution() {
    // Sums of 121 products in another order: far below 1e-12.
    assert!((similarity(&first(), &second()) - 0.460_315_578_005_332_96).abs() < 1e-12, "two patterns");
    let unit = |level: &u8| f32::from(*level) / 255.0;
    let pixels = |scale: f32, offset: f32| -> Vec<f32> {
        let pixel = |p: &[u8]| [0, 1, 2, 3].map(|c| if c == 3 { 7.0 } else { unit(&p[c]) * scale + offset });
        first().rgb().chunks(3).flat_map(pixel).collect()
    };
    let (same, faded) = (pixels(1.0, 0.0), pixels(0.9, 0.05));
    let same = Picture::from_rgba32f(WIDTH, HEIGHT, &same).expect("the length fits");
    let faded = Picture::from_rgba32f(WIDTH, HEIGHT, &faded).expect("the length fits");
    // Samples are f32 here: 6e-8 each, and SSIM's slope is of order one.
    assert!((ssim(&same, &faded).expect("equal sizes") - 0.993_549_819_633_175_6).abs() < 1e-6, "a faded picture");
}

#[test]
fn identical_pictures_have_similarity_one_and_infinite_psnr() {
    assert!((similarity(&first(), &first()) - 1.0).abs() < 1e-12, "rounding only");
    assert_eq!(error(&first(), &first()).psnr(), Decibels(f64::INFINITY));
    let (ab, ba) = (similarity(&first(), &second()), similarity(&second(), &first()));
    assert!((ab - ba).abs() < 1e-14, "symmetric");
    let dot = Frame::new(1, 1, vec![1, 2, 3]).expect("one pixel");
    assert!((similarity(&dot, &dot) - 1.0).abs() < 1e-12, "smaller than the window");
}

#[test]
fn psnr_of_one_level_is_48_decibels() {
    let base = frame(|x, y, c| (x + y + c) % 200);
    let up = frame(|x, y, c| (x + y + c) % 200 + 1);
    // 20 log10(255) = 48.1308.
    assert!((error(&base, &up).psnr().0 - 48.130_803_608_679_1).abs() < 1e-9, "20 log10 255");
}

#[test]
fn foreground_psnr_ignores_the_background_and_whole_psnr_flatters() {
    let base = frame(|_, _, _| 100);
    let marked = frame(|x, _, _| if x < 4 { 102 } else { 100 });
    let transmittance = (0..WIDTH * HEIGHT).map(|i| if i % WIDTH < 4 { 0.2 } else { 1.0 });
    let mask = foreground(transmittance, 0.5);
    assert_eq!(mask.iter().filter(|m| **m).count() as u32, 4 * HEIGHT);
    let (a, b) = (Picture::from_frame(&base), Picture::from_frame(&marked));
    let inside = SquaredError::within(&a, &b, &mask).expect("equal sizes").psnr().0;
    assert!((inside - 20.0 * 127.5_f64.log10()).abs() < 1e-9, "two levels everywhere inside: {inside}");
    // 10 log10(23/4): the published "15 % adds 8.2 dB, 20 % adds 7.0 dB" effect.
    let gain = error(&base, &marked).psnr().0 - inside;
    assert!((gain - 10.0 * (23.0_f64 / 4.0).log10()).abs() < 1e-9, "{gain}");
    assert_eq!(foreground([0.5, 0.49, f32::NAN, 0.0, 1.0], 0.5), [false, true, false, true, false]);
    assert!(SquaredError::within(&a, &b, &mask[1..]).is_err(), "mask of another size");
    let nothing = SquaredError::within(&a, &b, &vec![false; mask.len()]).expect("equal sizes");
    assert!(nothing.psnr().0.is_nan(), "nothing compared is no result");
}

#[test]
fn summaries_state_both_averages_and_handle_infinity_and_nan() {
    let view = |sum| SquaredError { sum, num_samples: 100 };
    let two = PsnrSummary::of(&[view(0.01), view(0.0001)]).expect("two views");
    // Mean square errors 1e-4 and 1e-6: 40 and 60 dB, pooled 5.05e-5.
    assert!((two.mean_of_views_db.0 - 50.0).abs() < 1e-9, "{two:?}");
    assert!((two.pooled_db.0 - 42.967_086_218_813_39).abs() < 1e-9, "{two:?}");
    assert!((two.min_db.0 - 40.0).abs() < 1e-9, "{two:?}");

    let with_same = PsnrSummary::of(&[view(0.01), view(0.0)]).expect("two views");
    assert_eq!((with_same.mean_of_views_db.0, with_same.num_identical), (f64::INFINITY, 1));
    assert!(with_same.pooled_db.0.is_finite() && with_same.min_db.0.is_finite(), "{with_same:?}");

    let poisoned = PsnrSummary::of(&[view(f64::NAN), view(0.01)]).expect("two views");
    assert!(poisoned.min_db.0.is_nan() && poisoned.mean_of_views_db.0.is_nan(), "{poisoned:?}");
    assert!(serde_json::to_string(&poisoned).is_err(), "NaN is not written as a figure");

    let empty = SquaredError { sum: 0.0, num_samples: 0 };
    assert_eq!(PsnrSummary::of(&[]), None);
    assert_eq!(PsnrSummary::of(&[empty]), None);
    assert_eq!(PsnrSummary::of(&[empty, view(0.01)]).expect("one view").num_views, 1);
}

#[test]
fn decibels_survive_json() {
    for db in [Decibels(49.87), Decibels(f64::INFINITY), Decibels(-3.0)] {
        let json = serde_json::to_string(&db).expect("a result");
        assert_eq!(serde_json::from_str::<Decibels>(&json).expect("our own form"), db);
    }
    assert_eq!(serde_json::to_string(&Decibels(f64::INFINITY)).expect("a result"), "\"inf\"");
    assert!(serde_json::from_str::<Decibels>("\"nan\"").is_err(), "nan");
    assert!(serde_json::from_str::<Decibels>("null").is_err(), "null");
    assert!(serde_json::to_string(&Decibels(f64::NEG_INFINITY)).is_err(), "an infinite error is no result");
}

#[test]
fn sizes_must_agree_and_nan_spreads() {
    let small = Frame::new(2, 2, vec![0; 12]).expect("the length fits");
    let tall = Frame::new(1, 4, vec![0; 12]).expect("the length fits");
    let (small, tall) = (Picture::from_frame(&small), Picture::from_frame(&tall));
    assert_eq!(ssim(&small, &tall).expect_err("two sizes").exit_code(), 2);
    assert_eq!(SquaredError::between(&small, &tall).expect_err("two sizes").exit_code(), 2);
    assert!(Picture::from_rgba32f(2, 2, &[0.0; 15]).is_err(), "length");
    let empty = Picture::from_rgba32f(0, 2, &[]).expect("an empty picture");
    assert!(ssim(&empty, &empty).is_err(), "nothing to compare");

    let mut pixels = [0.5; 16];
    let clean = Picture::from_rgba32f(2, 2, &[0.5; 16]).expect("the length fits");
    pixels[5] = f32::NAN;
    let poisoned = Picture::from_rgba32f(2, 2, &pixels).expect("the length fits");
    assert!(ssim(&clean, &poisoned).expect("equal sizes").is_nan(), "ssim");
    assert!(SquaredError::between(&clean, &poisoned).expect("equal sizes").psnr().0.is_nan(), "psnr");
}
