//! The gradient of LPIPS against differences, and what a pass keeps and refuses.

use guard4d_engine::error::EngineError;
use guard4d_engine::media::Frame;
use guard4d_engine::networks::lpips::{
    ImageSize, Lpips, LpipsGradient, LpipsInput, LpipsNet, LpipsPass, Pair, Reference,
};
use guard4d_kernels::Buffer;

use crate::support::close::{assert_close, largest};
use crate::support::gpu::{Gpu, device, each_family};
use crate::support::random::Random;
use crate::support::random_lpips;

/// A random network.
fn random_net(gpu: &Gpu) -> Lpips {
    let folder = tempfile::tempdir().expect("a temporary folder");
    Lpips::load(gpu, &random_lpips::write(folder.path()), LpipsInput::Canonical).expect("loads")
}

/// `frames` pictures `[F, H, W, 4]` of noise around a gradient; the fourth channel is not to be read.
fn clip(seed: u64, frames: usize, size: ImageSize) -> Vec<f32> {
    let noise = Random(seed).vec_f32(frames * size.height * size.width * 4, 0.0, 0.5);
    let slope = |i: usize| 0.5 * (i / 4 % size.width) as f32 / size.width as f32;
    noise.iter().enumerate().map(|(i, v)| if i % 4 == 3 { f32::NAN } else { v + slope(i) }).collect()
}

/// Distance and gradient, on top of zeros, of the part of `size` from `corner` on.
pub(super) fn value_and_gradient(
    gpu: &Gpu,
    net: &Lpips,
    [image, reference]: [&[f32]; 2],
    full: ImageSize,
    (corner, size): ([usize; 2], ImageSize),
) -> (f64, Vec<f32>) {
    let frames = image.len() / (full.height * full.width * 4);
    let pass = net.pass(size, frames).expect("room");
    compare(gpu, net, pass, [image, reference], (full, corner))
}

/// The same with this working memory.
fn compare(
    gpu: &Gpu,
    net: &Lpips,
    mut pass: LpipsPass,
    [image, reference]: [&[f32]; 2],
    (full, corner): (ImageSize, [usize; 2]),
) -> (f64, Vec<f32>) {
    let mut v_image = gpu.buffer::<f32>("v_image", image.len()).expect("buffer");
    let (image, reference) = (gpu.buffer_from("image", image), gpu.buffer_from("reference", reference));
    let (image, reference) = (image.expect("buffer"), reference.expect("buffer"));
    let mut rec = gpu.recorder().expect("recorder");
    let pair = Pair { image: &image, reference: &reference, full, corner };
    net.step(&mut rec, &mut pass, &pair, Some(LpipsGradient { v_image: &mut v_image, weight: 1.0 })).expect("records");
    rec.submit().expect("runs");
    let score = pass.score(&pass.values().read().expect("read"));
    (score.total(), v_image.read().expect("read"))
}

#[test]
fn the_gradient_is_the_slope() {
    let Some(gpu) = device() else { return };
    let net = random_net(&gpu);
    // Odd, so that strides and poolings leave pixels over.
    let full = ImageSize { height: 45, width: 38 };
    let (image, reference) = (clip(1, 1, full), clip(2, 1, full));
    let part = ([0, 0], full);
    let (value, gradient) = value_and_gradient(&gpu, &net, [&image, &reference], full, part);
    assert!(value > 0.0 && gradient.iter().all(|v| v.is_finite()), "{value}");
    let length = gradient.iter().map(|v| v * v).sum::<f32>().sqrt();
    // Along the gradient, by as much as moves the distance by some per mille.
    let step = 1e-3 * value as f32 / length;
    let moved = |sign: f32| {
        let moved: Vec<f32> = image.iter().zip(&gradient).map(|(x, v)| x + sign * step * v / length).collect();
        value_and_gradient(&gpu, &net, [&moved, &reference], full, part).0
    };
    let slope = (moved(1.0) - moved(-1.0)) / (2.0 * f64::from(step));
    // The distance is known to about 1e-7 of itself, its differences so to 1e-4; the kinks of ReLU and pooling take
    // more.
    assert_close(&[slope as f32], &[length], 0.0, 1e-2);
}

#[test]
fn frames_and_parts_are_compared_by_themselves() {
    let Some(gpu) = device() else { return };
    let net = random_net(&gpu);
    let full = ImageSize { height: 52, width: 47 };
    let size = ImageSize { height: 40, width: 36 };
    let corner = [7, 11];
    let (image, reference) = (clip(3, 2, full), clip(4, 2, full));
    let (value, gradient) = value_and_gradient(&gpu, &net, [&image, &reference], full, (corner, size));
    let cut = |clip: &[f32], frame: usize| -> Vec<f32> {
        let rows = (0..size.height).map(|y| ((frame * full.height + corner[0] + y) * full.width + corner[1]) * 4);
        rows.flat_map(|at| clip[at..at + size.width * 4].to_vec()).collect()
    };
    let (mut mean, mut inside) = (0.0, 0);
    for frame in 0..2 {
        let pair = [cut(&image, frame), cut(&reference, frame)];
        let (alone, slopes) = value_and_gradient(&gpu, &net, [&pair[0], &pair[1]], size, ([0, 0], size));
        mean += 0.5 * alone;
        let halves: Vec<f32> = slopes.iter().map(|v| 0.5 * v).collect();
        // The mean over two frames is rounded once more.
        let most = largest(halves.iter().map(|v| v.abs()));
        assert_close(&cut(&gradient, frame), &halves, 1e-6 * most, 1e-5);
        inside += halves.iter().filter(|v| **v != 0.0).count();
    }
    // Sums of some thousand f32 in another order.
    assert_close(&[value as f32], &[mean as f32], 0.0, 1e-5);
    let one_by_one = net.pass_within(size, 2, 0).expect("room");
    let (by_turns, slopes) = compare(&gpu, &net, one_by_one, [&image, &reference], (full, corner));
    assert_close(&[by_turns as f32], &[value as f32], 0.0, 1e-5);
    let most = largest(gradient.iter().map(|v| v.abs()));
    // The same sums, at most fused otherwise.
    assert_close(&slopes, &gradient, 1e-6 * most, 1e-5);
    assert_eq!(gradient.iter().filter(|v| **v != 0.0).count(), inside, "nothing outside the part");
}

#[test]
fn a_reference_whose_features_are_known_is_not_looked_at_and_gives_the_same_bits() {
    let Some(families) = each_family() else { return };
    let size = ImageSize { height: 52, width: 47 };
    let (image, reference) = (clip(5, 4, size), clip(6, 4, size));
    for gpu in &families {
        let net = random_net(gpu);
        let upload = |data: &[f32]| gpu.buffer_from("clip", data).expect("buffer");
        let (image, reference, blank) = (upload(&image), upload(&reference), upload(&vec![f32::NAN; reference.len()]));
        for chunk_bytes in [0, usize::MAX] {
            let mut pass = net.pass_within(size, 4, chunk_bytes).expect("room");
            let mut features = net.features(&pass).expect("room");
            assert_eq!(features.bytes(), pass.features_bytes(), "as it says");
            let mut compare = |reference: &Buffer<f32>, known: Reference<'_>| {
                let mut v_image = gpu.buffer::<f32>("v_image", image.len()).expect("buffer");
                let mut rec = gpu.recorder().expect("recorder");
                let pair = Pair { image: &image, reference, full: size, corner: [0, 0] };
                net.step_with(
                    &mut rec,
                    &mut pass,
                    &pair,
                    known,
                    Some(LpipsGradient { v_image: &mut v_image, weight: 1.0 }),
                )
                .expect("records");
                rec.submit().expect("runs");
                let read = [pass.values(), &v_image].map(|buffer| buffer.read().expect("reads"));
                read.concat().into_iter().map(f32::to_bits).collect::<Vec<_>>()
            };
            let unknown = compare(&reference, Reference::Unknown);
            assert!(unknown.iter().any(|v| f32::from_bits(*v) > 0.0), "there is a distance");
            assert!(unknown == compare(&reference, Reference::Keep(&mut features)), "kept");
            assert!(unknown == compare(&blank, Reference::Kept(&features)), "known");
            assert!(unknown != compare(&image, Reference::Unknown), "another reference");
            assert!(unknown == compare(&blank, Reference::Kept(&features)), "known still");
        }
    }
}

#[test]
fn equal_pictures_have_no_distance_and_no_gradient() {
    let Some(gpu) = device() else { return };
    let net = random_net(&gpu);
    let size = ImageSize { height: 31, width: 33 };
    let image = clip(5, 1, size);
    let (value, gradient) = value_and_gradient(&gpu, &net, [&image, &image], size, ([0, 0], size));
    assert!(value == 0.0 && gradient.iter().all(|v| *v == 0.0), "{value}");
    let black = vec![0.0; image.len()];
    let (value, gradient) = value_and_gradient(&gpu, &net, [&black, &image], size, ([0, 0], size));
    assert!(value > 0.0 && gradient.iter().all(|v| v.is_finite()), "{value}");
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let Some(gpu) = device() else { return };
    let net = random_net(&gpu);
    assert_eq!(net.net(), LpipsNet::Alex, "by its first layer");
    let side = LpipsNet::Alex.min_side_px();
    net.pass(ImageSize { height: side, width: side }, 1).expect("the least");
    for (height, width) in [(side - 1, 64), (64, side - 1), (0, 0)] {
        let refused = net.pass(ImageSize { height, width }, 1).expect_err("too small");
        assert!(matches!(&refused, EngineError::Usage { expected, .. } if expected.contains("31 px")), "{refused}");
    }
    let frame = |width: u32| Frame::new(width, 32, vec![9; 3 * 32 * width as usize]).expect("the length fits");
    let refused = net.distance(&frame(32), &frame(33)).expect_err("sizes");
    assert_eq!(refused.exit_code(), 2, "{refused}");
}
