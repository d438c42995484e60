//! Scores, taps and gradients of the reference implementation (lpips 0.1.4) with the same weights, where the test
//! material is.

use std::fs;
use std::path::Path;

use guard4d_engine::media::Frame;
use guard4d_engine::media::ffmpeg::Ffmpeg;
use guard4d_engine::media::folder::read_picture;
use guard4d_engine::networks::lpips::{Lpips, LpipsInput, size_of_frame};
use serde_json::Value;

use super::pass::value_and_gradient;
use crate::support::close::{assert_close, largest};
use crate::support::gpu::{Gpu, device};
use crate::support::shared;

/// Share of itself that a score may be off: sums of up to 4608 products in f32, through up to 13 layers, in another
/// order.
const RTOL: f32 = 2e-5;
/// The same for gradients, which pass twice as many layers, and kinks that rounding may cross.
const GRADIENT_RTOL: f32 = 1e-3;

fn picture(folder: &Path, case: &Value, name: &str) -> Frame {
    let file = case[name].as_str().expect("a file name");
    read_picture(&folder.join(file), [0; 3], &Ffmpeg::default()).expect("a picture")
}

fn number(value: &Value) -> f32 {
    value.as_f64().expect("a number") as f32
}

fn check_case(gpu: &Gpu, folder: &Path, [net, unit_fed]: &[Lpips; 2], case: &Value) {
    let (a, b) = (picture(folder, case, "a"), picture(folder, case, "b"));
    let score = net.distance(&a, &b).expect("compares");
    let per_tap: Vec<f32> = case["per_layer"].as_array().expect("a list").iter().map(number).collect();
    assert_close(&score.per_tap.map(|v| v as f32), &per_tap, 1e-7, RTOL);
    assert_close(&[score.total() as f32], &[number(&case["score"])], 1e-7, RTOL);

    let size = size_of_frame(&a);
    let clips = [a.to_rgba32f(), b.to_rgba32f()];
    let (value, gradient) = value_and_gradient(gpu, net, [&clips[0], &clips[1]], size, ([0, 0], size));
    assert_close(&[value as f32], &[score.total() as f32], 1e-7, 1e-6);
    // The reference's colours go from -1 to 1, so that ours have twice its slopes.
    let length = gradient.iter().map(|v| (0.5 * f64::from(*v)).powi(2)).sum::<f64>().sqrt() as f32;
    let most = largest(gradient.iter().map(|v| 0.5 * v.abs()));
    let (want, want_largest) = (number(&case["grad_l2"]), number(&case["grad_absmax"]));
    assert_close(&[length, most], &[want, want_largest], 1e-9, GRADIENT_RTOL);
    let at = 0.5 * gradient[(10 * size.width + 20) * 4];
    assert_close(&[at], &[number(&case["grad_at_c0_y10_x20"])], GRADIENT_RTOL * want_largest, GRADIENT_RTOL);

    let unit_fed = unit_fed.distance(&a, &b).expect("compares").total();
    assert_close(&[unit_fed as f32], &[number(&case["unscaled_0_1"])], 1e-7, RTOL);
}

/// All cases of one checkpoint; how many there were.
fn check(weights: &str) {
    let (Some(gpu), Some(path)) = (device(), shared("weights/lpips/fixtures/reference.json")) else { return };
    let folder = path.parent().expect("a folder above");
    let all: Value = serde_json::from_slice(&fs::read(&path).expect("readable")).expect("JSON");
    let cases = all["cases"].as_array().expect("a list").iter().filter(|case| case["weights"] == weights);
    let path = folder.with_file_name(weights);
    let nets =
        [LpipsInput::Canonical, LpipsInput::UnitFed].map(|input| Lpips::load(&gpu, &path, input).expect("loads"));
    assert_eq!(cases.map(|case| check_case(&gpu, folder, &nets, case)).count(), 4, "cases of {weights}");
}

#[test]
fn alexnet_agrees_with_the_reference() {
    check("lpips_alex_f16.safetensors");
}

#[test]
fn vgg16_agrees_with_the_reference() {
    check("lpips_vgg16_f16.safetensors");
}

/// The picture at another size, each pixel that of the place that it comes from (nearest, as `PyTorch` rounds it).
fn resampled(frame: &Frame, width: u32, height: u32) -> Frame {
    let source = |x: u32, y: u32| (y * frame.height() / height * frame.width() + x * frame.width() / width) as usize;
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let rgb = pixels.flat_map(|(x, y)| frame.rgb()[3 * source(x, y)..][..3].to_vec()).collect();
    Frame::new(width, height, rgb).expect("the length fits")
}

#[test]
fn odd_sizes_agree_with_the_reference() {
    let (Some(gpu), Some(path)) = (device(), shared("weights/lpips/fixtures/reference.json")) else { return };
    let folder = path.parent().expect("a folder above");
    let all: Value = serde_json::from_slice(&fs::read(&path).expect("readable")).expect("JSON");
    let read = |name: &str| read_picture(&folder.join(name), [0; 3], &Ffmpeg::default()).expect("a picture");
    let weights = folder.with_file_name("lpips_vgg16_f16.safetensors");
    let net = Lpips::load(&gpu, &weights, LpipsInput::Canonical).expect("loads");
    let [apple, pear] = ["apple.png", "pear.png"].map(|name| resampled(&read(name), 53, 37));
    let score = net.distance(&apple, &pear).expect("compares").total() as f32;
    assert_close(&[score], &[number(&all["odd_size_37x53_nearest_apple_pear_vgg"])], 1e-7, RTOL);
}
