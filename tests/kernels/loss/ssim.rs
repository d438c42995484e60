//! loss/ssim: twin against differences and PyTorch, GPU against both, borders, poison.

use guard4d_kernels::KernelError;
use guard4d_kernels::image::resize::ImageSize;
use guard4d_kernels::loss::ssim::{SsimPair, SsimReference, SsimScratch, prepare, step};
use guard4d_kernels::reference::loss::ssim as twin;
use guard4d_kernels::shape::Accumulate;

use super::{run, term, unwritten, upload};
use crate::support::close::{assert_close, cosine, largest};
use crate::support::golden::Golden;
use crate::support::gpu::{Gpu, device};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(1);
    for (height, width) in [(3, 4), (13, 2)] {
        let image = random.vec(height * width * 4, 0.0, 1.0);
        let reference = random.vec(height * width * 4, 0.0, 1.0);
        let grad = twin::step(&image, &reference, height, width).1;
        let worst = gradcheck(|x| twin::step(x, &reference, height, width).0, &image, &grad);
        assert!(worst < 1e-6, "{height} x {width}: {worst}");
    }
}

/// Mean of 1 − SSIM of a clip and its gradient with weight 1; with `Add` on top of 0.5.
fn on_gpu(gpu: &Gpu, [height, width]: [usize; 2], x: &[f32], y: &[f32], accumulate: Accumulate) -> (f32, Vec<f32>) {
    let size = ImageSize { height, width };
    let frame = height * width * 4;
    let frames = x.len() / frame;
    let mut scratch = SsimScratch::new(gpu, size, frames).expect("scratch");
    let mut moments = SsimReference::new(gpu, size, frames).expect("moments");
    let (clip, reference) = (upload(gpu, x), upload(gpu, y));
    let mut v_clip =
        if accumulate == Accumulate::Add { upload(gpu, &vec![0.5; x.len()]) } else { unwritten(gpu, x.len()) };
    let mut values = upload(gpu, &[7.0; 2]);
    run(gpu, |rec| {
        prepare(rec, &reference, &mut moments, &mut scratch)?;
        let pair = SsimPair { clip: &clip, reference: &reference, moments: &moments };
        step(rec, &pair, &mut v_clip, term(&mut values, 1.0, accumulate), &mut scratch)
    });
    (values.read().expect("read")[1], v_clip.read().expect("read"))
}

#[test]
fn twin_and_gpu_match_pytorch() {
    let golden = Golden::load("ssim");
    let shape = golden.shape("x");
    let (frames, size) = (shape[0], [shape[1], shape[2]]);
    let per_frame = size[0] * size[1] * 4;
    let (mut value, mut grad) = (0.0, vec![]);
    for (x, y) in golden.f64("x").chunks_exact(per_frame).zip(golden.f64("y").chunks_exact(per_frame)) {
        let (v, g) = twin::step(x, y, size[0], size[1]);
        value += v / frames as f64;
        grad.extend(g.into_iter().map(|g| (g / frames as f64) as f32));
    }
    // PyTorch's value is the similarity.
    let want: Vec<f32> = golden.f32("value").iter().map(|v| 1.0 - v).collect();
    let want_grad: Vec<f32> = golden.f32("v_x").iter().map(|v| -v).collect();
    let most = largest(want_grad.iter().map(|g| g.abs()));
    // Both in f64; what remains is the file's f32.
    assert_close(&[value as f32], &want, 1e-6, 0.0);
    assert_close(&grad, &want_grad, most * 1e-6, 1e-6);

    let Some(gpu) = device() else { return };
    let (value, v_x) = on_gpu(&gpu, size, &golden.f32("x"), &golden.f32("y"), Accumulate::Overwrite);
    // Variances are differences of f32 means near 1, divided by about C2 = 9e-4: errors of 1e-7 become 1e-4.
    assert_close(&[value], &want, 1e-4, 0.0);
    assert_close(&v_x, &want_grad, most * 2e-3, 0.0);
    assert!(cosine(&v_x, &want_grad) > 0.999_999, "directions agree: {}", cosine(&v_x, &want_grad));
}

#[test]
fn gpu_follows_the_twin_at_odd_sizes() {
    let Some(gpu) = device() else { return };
    for (frames, height, width) in [(1, 1, 1), (2, 3, 17), (1, 26, 70), (2, 8, 64)] {
        let mut random = Random((height * width) as u64);
        let x = random.vec_f32(frames * height * width * 4, 0.0, 1.0);
        let y = random.vec_f32(frames * height * width * 4, 0.0, 1.0);
        let (mut value, mut grad) = (0.0, vec![]);
        let per_frame = height * width * 4;
        for (x, y) in x.chunks_exact(per_frame).zip(y.chunks_exact(per_frame)) {
            let (v, g) = twin::step(x, y, height, width);
            value += v / frames as f32;
            grad.extend(g.into_iter().map(|g| g / frames as f32));
        }
        let (got, v_x) = on_gpu(&gpu, [height, width], &x, &y, Accumulate::Overwrite);
        let most = largest(grad.iter().map(|g| g.abs()));
        // Noise has variances near 0.08, so the division is harmless: rounding of two dozen sums.
        assert_close(&[got], &[value], 1e-5, 1e-5);
        assert_close(&v_x, &grad, most * 1e-4, 1e-4);
        let (again, added) = on_gpu(&gpu, [height, width], &x, &y, Accumulate::Add);
        assert_eq!(got.to_bits(), again.to_bits(), "the same bits twice");
        let sum: Vec<f32> = v_x.iter().enumerate().map(|(i, v)| if i % 4 < 3 { v + 0.5 } else { 0.0 }).collect();
        assert_close(&added, &sum, 1e-7, 0.0);
    }
}

#[test]
fn equal_images_have_no_loss_and_no_slope() {
    let Some(gpu) = device() else { return };
    let x = Random(9).vec_f32(20 * 20 * 4, 0.0, 1.0);
    let (value, v_x) = on_gpu(&gpu, [20, 20], &x, &x, Accumulate::Overwrite);
    assert_eq!(value, 0.0, "loss of equal images");
    assert!(v_x.iter().all(|v| *v == 0.0), "its gradient");
}

/// An image `[H,W,4]` with flat, smooth and busy parts, all colours between 0.1 and 0.9.
fn picture(random: &mut Random, height: usize, width: usize) -> Vec<f32> {
    let noise = random.vec_f32(height * width * 4, -0.1, 0.1);
    let texel = |(i, n): (usize, &f32)| {
        let (row, column) = (i / 4 / width, i / 4 % width);
        match 3 * column / width {
            0 => 0.8,
            1 => 0.2 + 0.6 * row as f32 / height as f32,
            _ => 0.5 + n,
        }
    };
    noise.iter().enumerate().map(texel).collect()
}

#[test]
fn differences_far_below_an_8_bit_step_keep_their_precision() {
    let Some(gpu) = device() else { return };
    let [height, width] = [40, 60];
    for (widest, shift) in [(2e-4, 0.0), (2e-5, 0.0), (1e-4, 2e-4)] {
        let mut random = Random(4);
        let y = picture(&mut random, height, width);
        let change = random.vec_f32(y.len(), shift - widest, shift + widest);
        let x: Vec<f32> = y.iter().zip(&change).map(|(y, d)| y + d).collect();
        let wide = |v: &[f32]| v.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
        let (want, grad) = twin::step(&wide(&x), &wide(&y), height, width);
        let (value, v_x) = on_gpu(&gpu, [height, width], &x, &y, Accumulate::Overwrite);
        let grad: Vec<f32> = grad.iter().map(|g| *g as f32).collect();
        let steepest = largest(grad.iter().map(|g| g.abs()));
        // Variances of the reference are off by 2e-7 at most, against C2 = 9e-4 or more: 2.2e-4 of each term.
        assert_close(&[value], &[want as f32], 0.0, 5e-4);
        assert_close(&v_x, &grad, steepest * 1e-3, 0.0);
    }
}

#[test]
fn poison_shows_within_two_windows() {
    let Some(gpu) = device() else { return };
    let mut x = vec![0.5; 64 * 64 * 4];
    x[(32 * 64 + 32) * 4 + 1] = f32::NAN;
    x[4] = 1e-40;
    let (value, v_x) = on_gpu(&gpu, [64, 64], &x, &vec![0.5; 64 * 64 * 4], Accumulate::Overwrite);
    assert!(value.is_nan(), "a NaN is not hidden");
    for (i, v) in v_x.iter().enumerate() {
        let (row, column) = (i / 4 / 64, i / 4 % 64);
        let near = i % 4 == 1 && row.abs_diff(32) <= 10 && column.abs_diff(32) <= 10;
        assert_eq!(v.is_nan(), near, "row {row}, column {column}, channel {}: {v}", i % 4);
    }
}

#[test]
fn poison_spreads_as_in_the_twin() {
    let Some(gpu) = device() else { return };
    let [height, width] = [25, 27];
    let split = height * width * 4;
    let clean = Random(6).vec_f32(2 * split, 0.0, 1.0);
    let on_gpu = |data: &[f32]| {
        let (value, v_x) = on_gpu(&gpu, [height, width], &data[..split], &data[split..], Accumulate::Overwrite);
        [vec![value], v_x].concat()
    };
    let on_host = |data: &[f32]| {
        let (value, grad) = twin::step(&data[..split], &data[split..], height, width);
        [vec![value], grad].concat()
    };
    let most = largest(on_host(&clean)[1..].iter().map(|g| g.abs()));
    let at = (3 * width + 20) * 4 + 1;
    // As at odd sizes.
    let reach = poison::spread(&clean, &[at, at + 2, split + at], (most * 1e-4, 1e-4), on_gpu, on_host);
    // Two windows of 11 on either side, cut by the border.
    let near = (3 + 1 + 10) * (10 + 1 + 6);
    assert_eq!(reach, [1 + near, 0, 1 + near], "a colour of either image, and the fourth channel");
}

#[test]
fn wrong_shapes_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let size = ImageSize { height: 4, width: 4 };
    let mut moments = SsimReference::new(&gpu, size, 1).expect("moments");
    let mut scratch = SsimScratch::new(&gpu, size, 1).expect("scratch");
    let (one, two, mut v_clip) = (upload(&gpu, &[0.0; 64]), upload(&gpu, &[0.0; 128]), upload(&gpu, &[0.0; 128]));
    let mut values = upload(&gpu, &[0.0; 2]);
    let mut rec = gpu.recorder().expect("recorder");
    let refused = prepare(&mut rec, &two, &mut moments, &mut scratch);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "reference", .. })), "{refused:?}");
    for (clip, reference, wrong) in [(&two, &one, "clip"), (&one, &two, "reference"), (&one, &one, "v_clip")] {
        let pair = SsimPair { clip, reference, moments: &moments };
        let to = term(&mut values, 1.0, Accumulate::Add);
        let refused = step(&mut rec, &pair, &mut v_clip, to, &mut scratch);
        assert!(matches!(&refused, Err(KernelError::Shape { buffer, .. }) if *buffer == wrong), "{refused:?}");
    }
    let moments = SsimReference::new(&gpu, size, 2).expect("moments");
    let pair = SsimPair { clip: &two, reference: &two, moments: &moments };
    let to = term(&mut values, 1.0, Accumulate::Add);
    let refused = step(&mut rec, &pair, &mut v_clip, to, &mut scratch);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "scratch.partial", .. })), "{refused:?}");
    let (none, mut v_none) = (upload(&gpu, &[]), upload(&gpu, &[]));
    let moments = SsimReference::new(&gpu, size, 0).expect("moments");
    let pair = SsimPair { clip: &none, reference: &none, moments: &moments };
    let to = term(&mut values, 1.0, Accumulate::Add);
    step(&mut rec, &pair, &mut v_none, to, &mut scratch).expect("no frame, no work");
}
