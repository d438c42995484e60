//! loss/mse: twin against differences, GPU against the twin, offsets, poison.

use guard4d_kernels::KernelError;
use guard4d_kernels::loss::PixelPair;
use guard4d_kernels::loss::mse::step;
use guard4d_kernels::loss::sum::SumScratch;
use guard4d_kernels::reference::loss::mse as twin;
use guard4d_kernels::shape::Accumulate;

use super::{run, term, upload};
use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(1);
    let (image, reference) = (random.vec(24, 0.0, 1.0), random.vec(24, 0.0, 1.0));
    let grad = twin::step(&image, &reference).1;
    let worst = gradcheck(|x| twin::step(x, &reference).0, &image, &grad);
    assert!(worst < 1e-6, "{worst}");
}

/// `(value, v_image)` of `num_px` pixels from 3 in the image and from 1 in the reference; gradients start as 0.5.
fn on_gpu(gpu: &Gpu, image: &[f32], reference: &[f32], num_px: usize, accumulate: Accumulate) -> (f32, Vec<f32>) {
    let mut v_image = upload(gpu, &vec![0.5; image.len()]);
    let (image, reference) = (upload(gpu, image), upload(gpu, reference));
    let mut values = upload(gpu, &[7.0, 7.0]);
    let mut scratch = SumScratch::new(gpu, num_px).expect("scratch");
    let pair = PixelPair { image: &image, image_px: 3, reference: &reference, reference_px: 1, num_px };
    run(gpu, |rec| step(rec, &pair, &mut v_image, term(&mut values, 2.0, accumulate), &mut scratch));
    let values = values.read().expect("read");
    assert_eq!(values[0], 7.0, "other slots are untouched");
    (values[1], v_image.read().expect("read"))
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for n in [0, 1, 7, 1024, 1025, 3000] {
        let mut random = Random(n as u64);
        let image = random.vec_f32((n + 4) * 4, 0.0, 1.0);
        let mut reference = random.vec_f32((n + 1) * 4, 0.0, 1.0);
        if n > 1 {
            reference[8] = image[16]; // an equal pair: no slope
        }
        let (want, grad) = twin::step(&image[12..(n + 3) * 4], &reference[4..]);
        for accumulate in [Accumulate::Overwrite, Accumulate::Add] {
            let (value, v_image) = on_gpu(&gpu, &image, &reference, n, accumulate);
            // A sum of n terms below 1 in another order, divided by n.
            assert_close(&[value], &[if n == 0 { 0.0 } else { want }], 1e-6, 1e-5);
            let before = if accumulate == Accumulate::Add { 0.5 } else { 0.0 };
            let mut full = vec![0.5; image.len()];
            for (i, g) in grad.iter().enumerate() {
                full[12 + i] = if i % 4 < 3 { before + 2.0 * g } else { 0.0 };
            }
            assert_close(&v_image, &full, 1e-7, 1e-6);
        }
    }
}

#[test]
fn poison_shows_and_wrong_shapes_are_refused() {
    let Some(gpu) = device() else { return };
    let mut image = vec![0.25; 40];
    image[20] = f32::NAN;
    image[17] = 1e-40;
    let (value, v_image) = on_gpu(&gpu, &image, &[0.5; 40], 7, Accumulate::Overwrite);
    assert!(value.is_nan() && v_image[20].is_nan(), "a NaN is not hidden: {value}");
    assert!(v_image.iter().enumerate().all(|(i, v)| i == 20 || v.is_finite()), "the others are untouched: {v_image:?}");

    let (x, mut v_x) = (upload(&gpu, &[0.0; 40]), upload(&gpu, &[0.0; 40]));
    let mut values = upload(&gpu, &[0.0; 2]);
    let mut scratch = SumScratch::new(&gpu, 10).expect("scratch");
    let pair = PixelPair { image: &x, image_px: 3, reference: &x, reference_px: 0, num_px: 8 };
    let mut rec = gpu.recorder().expect("recorder");
    let refused = step(&mut rec, &pair, &mut v_x, term(&mut values, 1.0, Accumulate::Add), &mut scratch);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "image", .. })), "{refused:?}");
    let pair = PixelPair { image_px: 0, num_px: 10, ..pair };
    let mut tiny = SumScratch::new(&gpu, 0).expect("scratch");
    let refused = step(&mut rec, &pair, &mut v_x, term(&mut values, 1.0, Accumulate::Add), &mut tiny);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "scratch", .. })), "{refused:?}");
}
