//! nn/conv2d: twin against differences, GPU against the twin, families against each other, poison.

use guard4d_kernels::nn::activation::Activation;
use guard4d_kernels::nn::conv2d::{Conv2d, FilterBank, Filters, backward, forward};
use guard4d_kernels::reference::nn::{activation as relu, conv2d as twin};
use guard4d_kernels::{Device, KernelError};

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::{device, each_family};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

/// Images `[F, H, W]`.
const fn images(frames: usize, height: usize, width: usize) -> twin::Conv2d {
    twin::Conv2d { frames, height, width, in_channels: 8, out_channels: 8, taps: 1, padding: 0 }
}

/// The same `images` through filters of other sizes.
const fn filtered(
    images: twin::Conv2d,
    in_channels: usize,
    out_channels: usize,
    taps: usize,
    padding: usize,
) -> twin::Conv2d {
    twin::Conv2d { in_channels, out_channels, taps, padding, ..images }
}

/// Single pixels, odd sizes, channels that are padded, every filter of `AlexNet` and VGG, and so many rows that a GPU
/// gets large tiles.
const SHAPES: [twin::Conv2d; 7] = [
    filtered(images(1, 1, 1), 8, 8, 1, 0),
    filtered(images(1, 1, 1), 3, 8, 3, 1),
    filtered(images(2, 5, 7), 3, 11, 3, 1),
    filtered(images(1, 4, 9), 16, 8, 3, 0),
    filtered(images(2, 6, 6), 12, 24, 5, 2),
    filtered(images(1, 3, 3), 8, 48, 3, 2),
    filtered(images(1, 37, 33), 8, 72, 3, 1),
];

fn parts(s: &twin::Conv2d) -> [usize; 4] {
    let (height, width) = s.out_size();
    [
        s.frames * s.height * s.width * s.in_channels,
        s.out_channels * s.in_channels * s.taps * s.taps,
        s.out_channels,
        s.frames * height * width * s.out_channels,
    ]
}

#[test]
fn twin_gradient_matches_differences() {
    for s in &SHAPES[..4] {
        let mut random = Random(s.width as u64);
        let [x, weight, bias, v_y] = parts(s).map(|n| random.vec(n, -1.0, 1.0));
        let error =
            gradcheck(|x| dot(&twin::forward(s, x, &weight, &bias), &v_y), &x, &twin::backward(s, &weight, &v_y));
        assert!(error < 1e-6, "{s:?}: {error}");
    }
}

/// Pixels of `channels` with as many as there are stored, zeros at the end; and the other way round.
fn restack(data: &[f32], from: usize, to: usize) -> Vec<f32> {
    let restacked = |pixel: &[f32]| (0..to).map(|c| pixel.get(c).copied().unwrap_or(0.0)).collect::<Vec<_>>();
    data.chunks_exact(from).flat_map(restacked).collect()
}

/// Output behind a ReLU, and the gradient of x's ReLU for `v_y`. The gate is longer than it has to be, as behind a
/// batch of which only the first half has a gradient.
fn on_gpu(gpu: &Device, s: &twin::Conv2d, [x, weight, bias, v_y]: [&[f32]; 4]) -> [Vec<f32>; 2] {
    let twin::Conv2d { frames, height, width, in_channels, out_channels, taps, padding } = *s;
    let bank = FilterBank { weight, bias, out_channels, in_channels, taps };
    let filters = Filters::new(gpu, "filters", &bank).expect("packs");
    let (stored_in, stored_out) = (filters.in_channels(), filters.out_channels());
    let mut stored_x = restack(x, in_channels, stored_in);
    let input = upload(gpu, &stored_x);
    stored_x.extend_from_within(..);
    let gate = upload(gpu, &stored_x);
    let v_y = upload(gpu, &restack(v_y, out_channels, stored_out));
    let (mut y, mut v_x) = (unwritten(gpu, v_y.len()), unwritten(gpu, input.len()));
    let conv = Conv2d { frames, height, width, padding };
    run(gpu, |rec| {
        forward(rec, &conv, &filters, &input, Activation::Relu, &mut y)?;
        backward(rec, &conv, &filters, &v_y, Some(&gate), &mut v_x)
    });
    let restore = |data: Vec<f32>, from, to| restack(&data, from, to);
    [
        restore(y.read().expect("read"), stored_out, out_channels),
        restore(v_x.read().expect("read"), stored_in, in_channels),
    ]
}

fn on_host(s: &twin::Conv2d, [x, weight, bias, v_y]: [&[f32]; 4]) -> [Vec<f32>; 2] {
    let y = relu::forward(Activation::Relu, &twin::forward(s, x, weight, bias));
    [y, relu::backward(Activation::Relu, x, &twin::backward(s, weight, v_y))]
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for s in &SHAPES {
        let mut random = Random((s.height * s.in_channels) as u64);
        let data = parts(s).map(|n| random.vec_f32(n, -1.0, 1.0));
        let data = data.each_ref().map(Vec::as_slice);
        // At most 9 * 72 terms below 1 in other orders, each sum off by some of its 2^-24-th parts.
        for (got, want) in on_gpu(&gpu, s, data).iter().zip(on_host(s, data)) {
            assert_close(got, &want, 2e-5, 1e-5);
        }
    }
}

#[test]
fn both_families_agree() {
    let Some(families) = each_family() else { return };
    let s = &SHAPES[6];
    let mut random = Random(3);
    let data = parts(s).map(|n| random.vec_f32(n, -1.0, 1.0));
    let data = data.each_ref().map(Vec::as_slice);
    let [lanes, tiles] = families.each_ref().map(|gpu| on_gpu(gpu, s, data).concat());
    // Both add in the order of k, but a compiler may fuse a product with its sum.
    assert_close(&lanes, &tiles, 1e-5, 1e-5);
}

#[test]
fn poison_reaches_the_windows_over_it_and_no_further() {
    let Some(gpu) = device() else { return };
    let s = filtered(images(1, 5, 6), 8, 8, 3, 1);
    let [x, weight, bias, v_y] = parts(&s);
    let mut random = Random(4);
    let mut clean = random.vec_f32(x, 0.1, 1.0);
    clean.extend(random.vec_f32(weight, 0.1, 1.0));
    clean.extend(random.vec_f32(bias + v_y, 0.1, 1.0));
    let split = |data: &[f32]| {
        let (image, rest) = data.split_at(x);
        let (filters, rest) = rest.split_at(weight);
        let (bias, v_y) = rest.split_at(bias);
        [image, filters, bias, v_y].map(<[f32]>::to_vec)
    };
    let on_gpu = |data: &[f32]| on_gpu(&gpu, &s, split(data).each_ref().map(Vec::as_slice)).concat();
    let on_host = |data: &[f32]| on_host(&s, split(data).each_ref().map(Vec::as_slice)).concat();
    // A corner pixel lies in 4 windows, an inner one in 9; an output gradient likewise. 72 terms in other orders.
    let places = [0, (6 + 2) * 8, x + weight + bias, x + weight + bias + (6 + 2) * 8];
    let reach = poison::spread(&clean, &places, (1e-5, 1e-5), on_gpu, on_host);
    // The gate lets a gradient through where a NaN is, but that gradient is a number.
    assert_eq!(reach, [4 * 8, 9 * 8, 4 * 8, 9 * 8], "outputs, then gradients");
}

#[test]
fn what_does_not_fit_is_refused() {
    let Some(gpu) = device() else { return };
    let weight = [0.0; 64];
    let bank = FilterBank { weight: &weight, bias: &[0.0; 8], out_channels: 8, in_channels: 8, taps: 1 };
    let wrong = Filters::new(&gpu, "filters", &FilterBank { taps: 3, ..bank }).map(|_| ());
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "weight", .. })), "{wrong:?}");
    let wrong = Filters::new(&gpu, "filters", &FilterBank { bias: &[0.0; 7], ..bank }).map(|_| ());
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "bias", .. })), "{wrong:?}");
    let filters = Filters::new(&gpu, "filters", &bank).expect("packs");
    let (x, mut y) = (upload(&gpu, &[0.0; 8 * 6]), unwritten(&gpu, 8 * 6));
    let conv = Conv2d { frames: 1, height: 2, width: 3, padding: 0 };
    let mut rec = gpu.recorder().expect("recorder");
    let act = Activation::Identity;
    let wrong = forward(&mut rec, &Conv2d { frames: 2, ..conv }, &filters, &x, act, &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "x", .. })), "{wrong:?}");
    let wrong = forward(&mut rec, &Conv2d { padding: 1, ..conv }, &filters, &x, act, &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "taps", .. })), "{wrong:?}");
    let wrong = forward(&mut rec, &Conv2d { height: 1, ..conv }, &filters, &x, act, &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "y", .. })), "{wrong:?}");
    let wrong = backward(&mut rec, &Conv2d { height: 0, ..conv }, &filters, &x, None, &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "taps", .. })), "{wrong:?}");
    let short = upload(&gpu, &[1.0; 8]);
    let wrong = backward(&mut rec, &conv, &filters, &x, Some(&short), &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "aux", .. })), "{wrong:?}");
    // No frame, no work.
    let (none, mut empty) = (upload(&gpu, &[]), unwritten(&gpu, 0));
    run(&gpu, |rec| forward(rec, &Conv2d { frames: 0, ..conv }, &filters, &none, act, &mut empty));
}
