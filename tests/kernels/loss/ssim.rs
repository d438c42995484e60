//! loss/ssim: twin against differences and PyTorch, GPU against both, borders, poison.

use guard4d_kernels::KernelError;
use guard4d_kernels::image::resize::ImageSize;
use guard4d_kernels::loss::ssim::{SsimReference, SsimScratch, prepare, step};
use guard4d_kernels::reference::loss::ssim as twin;
use guard4d_kernels::shape::Accumulate;

use super::{run, term, unwritten, upload};
use crate::support::close::{assert_close, cosine};
use crate::support::golden::Golden;
use crate::support::gpu::{Gpu, device};
use crate::support::gradcheck::gradcheck;
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

/// Mean SSIM of a clip and its gradient with weight 1; with `Add` on top of 0.5.
fn on_gpu(gpu: &Gpu, [height, width]: [usize; 2], x: &[f32], y: &[f32], accumulate: Accumulate) -> (f32, Vec<f32>) {
    let size = ImageSize { height, width };
    let frame = height * width * 4;
    let frames = x.len() / frame;
    let mut scratch = SsimScratch::new(gpu, size, frames).expect("scratch");
    let mut references: Vec<_> =
        y.chunks_exact(frame).map(|y| SsimReference::new(gpu, size, upload(gpu, y)).expect("reference")).collect();
    let clip = upload(gpu, x);
    let mut v_clip =
        if accumulate == Accumulate::Add { upload(gpu, &vec![0.5; x.len()]) } else { unwritten(gpu, x.len()) };
    let mut values = upload(gpu, &[7.0; 2]);
    run(gpu, |rec| {
        for reference in &mut references {
            prepare(rec, reference, &mut scratch)?;
        }
        let references: Vec<_> = references.iter().collect();
        step(rec, (&clip, &references), &mut v_clip, term(&mut values, 1.0, accumulate), &mut scratch)
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
    let (want, want_grad) = (golden.f32("value"), golden.f32("v_x"));
    let largest = want_grad.iter().fold(0.0, |m: f32, g| m.max(g.abs()));
    // Both in f64; what remains is the file's f32.
    assert_close(&[value as f32], &want, 1e-6, 0.0);
    assert_close(&grad, &want_grad, largest * 1e-6, 1e-6);

    let Some(gpu) = device() else { return };
    let (value, v_x) = on_gpu(&gpu, size, &golden.f32("x"), &golden.f32("y"), Accumulate::Overwrite);
    // Variances are differences of f32 means near 1, divided by about C2 = 9e-4: errors of 1e-7 become 1e-4.
    assert_close(&[value], &want, 1e-4, 0.0);
    assert_close(&v_x, &want_grad, largest * 2e-3, 0.0);
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
        let largest = grad.iter().fold(0.0, |m: f32, g| m.max(g.abs()));
        // Noise has variances near 0.08, so the division is harmless: rounding of two dozen sums.
        assert_close(&[got], &[value], 1e-5, 1e-5);
        assert_close(&v_x, &grad, largest * 1e-4, 1e-4);
        let (again, added) = on_gpu(&gpu, [height, width], &x, &y, Accumulate::Add);
        assert_eq!(got.to_bits(), again.to_bits(), "the same bits twice");
        let sum: Vec<f32> = v_x.iter().enumerate().map(|(i, v)| if i % 4 < 3 { v + 0.5 } else { 0.0 }).collect();
        assert_close(&added, &sum, 1e-7, 0.0);
    }
}

#[test]
fn equal_images_score_one_without_slope() {
    let Some(gpu) = device() else { return };
    let x = Random(9).vec_f32(20 * 20 * 4, 0.0, 1.0);
    let (value, v_x) = on_gpu(&gpu, [20, 20], &x, &x, Accumulate::Overwrite);
    assert!((value - 1.0).abs() < 1e-5, "SSIM of equal images: {value}");
    // The three slopes cancel up to rounding of terms near 1/(sigma^2 n) = 12/1200.
    assert!(v_x.iter().all(|v| v.abs() < 1e-6), "its gradient");
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
fn wrong_shapes_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let size = ImageSize { height: 4, width: 4 };
    let refused = SsimReference::new(&gpu, size, upload(&gpu, &[0.0; 60]));
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "reference", .. })), "{refused:?}");
    let reference = SsimReference::new(&gpu, size, upload(&gpu, &[0.0; 64])).expect("reference");
    let mut scratch = SsimScratch::new(&gpu, size, 1).expect("scratch");
    let (clip, mut v_clip) = (upload(&gpu, &[0.0; 128]), upload(&gpu, &[0.0; 128]));
    let mut values = upload(&gpu, &[0.0; 2]);
    let mut rec = gpu.recorder().expect("recorder");
    let to = term(&mut values, 1.0, Accumulate::Add);
    let refused = step(&mut rec, (&clip, &[&reference]), &mut v_clip, to, &mut scratch);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "clip", .. })), "{refused:?}");
    let (none, mut v_none) = (upload(&gpu, &[]), upload(&gpu, &[]));
    let to = term(&mut values, 1.0, Accumulate::Add);
    step(&mut rec, (&none, &[]), &mut v_none, to, &mut scratch).expect("no frame, no work");
}
