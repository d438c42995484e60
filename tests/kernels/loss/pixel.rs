//! loss/pixel: twin against differences, GPU against the twin, offsets, poison.

use guard4d_kernels::KernelError;
use guard4d_kernels::loss::PixelPair;
use guard4d_kernels::loss::pixel::{PixelWeights, step};
use guard4d_kernels::loss::sum::SumScratch;
use guard4d_kernels::reference::loss::pixel as twin;
use guard4d_kernels::shape::Accumulate;

use super::{run, term, upload};
use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(1);
    let (image, reference) = (random.vec(24, 0.0, 1.0), random.vec(24, 0.0, 1.0));
    for weights in [[1.0, 0.0], [0.0, 1.0], [0.3, 0.8]] {
        let loss = |x: &[f64]| {
            let ([square, absolute], _) = twin::step(x, &reference, weights);
            weights[0] * square + weights[1] * absolute
        };
        let grad = twin::step(&image, &reference, weights).1;
        let worst = gradcheck(loss, &image, &grad);
        assert!(worst < 1e-6, "{weights:?}: {worst}");
    }
}

/// Both values and v_image of `num_px` pixels from 3 in the image and from 1 in the reference; gradients start as 0.5
/// and get twice the weights.
fn on_gpu(
    gpu: &Gpu,
    image: &[f32],
    reference: &[f32],
    weights: PixelWeights,
    num_px: usize,
    accumulate: Accumulate,
) -> ([f32; 2], Vec<f32>) {
    let mut v_image = upload(gpu, &vec![0.5; image.len()]);
    let (image, reference) = (upload(gpu, image), upload(gpu, reference));
    let mut values = upload(gpu, &[7.0; 4]);
    let mut scratch = SumScratch::new(gpu, num_px).expect("scratch");
    let pair = PixelPair { image: &image, image_px: 3, reference: &reference, reference_px: 1, num_px };
    run(gpu, |rec| {
        let to = term(&mut values, 2.0, accumulate);
        step(rec, &pair, weights, Some(&mut v_image), to, &mut scratch)
    });
    let values = values.read().expect("read");
    let mut alone = upload(gpu, &[7.0; 4]);
    run(gpu, |rec| step(rec, &pair, weights, None, term(&mut alone, 2.0, accumulate), &mut scratch));
    let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    let alone = alone.read().expect("read");
    assert_eq!(bits(&alone), bits(&values), "the values do not depend on whether a gradient is wanted");
    assert_eq!([values[0], values[3]], [7.0; 2], "other slots are untouched");
    ([values[1], values[2]], v_image.read().expect("read"))
}

/// The same by the twin.
fn on_host(
    image: &[f32],
    reference: &[f32],
    weights: PixelWeights,
    num_px: usize,
    accumulate: Accumulate,
) -> ([f32; 2], Vec<f32>) {
    let seen = (&image[12..(num_px + 3) * 4], &reference[4..(num_px + 1) * 4]);
    let (values, grad) = twin::step(seen.0, seen.1, [weights.square, weights.absolute]);
    let before = if accumulate == Accumulate::Add { 0.5 } else { 0.0 };
    let mut full = vec![0.5; image.len()];
    for (i, g) in grad.iter().enumerate() {
        full[12 + i] = if i % 4 < 3 { before + 2.0 * g } else { 0.0 };
    }
    (values, full)
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
        for (square, absolute, accumulate) in
            [(0.0, 1.0, Accumulate::Overwrite), (1.0, 0.0, Accumulate::Overwrite), (0.7, 0.4, Accumulate::Add)]
        {
            let weights = PixelWeights { square, absolute };
            let (values, v_image) = on_gpu(&gpu, &image, &reference, weights, n, accumulate);
            let (want, full) = on_host(&image, &reference, weights, n, accumulate);
            // A sum of n terms below 1 in another order, divided by n.
            assert_close(&values, &if n == 0 { [0.0; 2] } else { want }, 1e-6, 1e-5);
            assert_close(&v_image, &full, 1e-7, 1e-6);
        }
    }
}

#[test]
fn poison_shows_and_wrong_shapes_are_refused() {
    let Some(gpu) = device() else { return };
    let both = PixelWeights { square: 1.0, absolute: 1.0 };
    let clean = Random(5).vec_f32(80, 0.0, 1.0);
    let split = |data: &[f32]| (data[..40].to_vec(), data[40..].to_vec());
    let joined = |(values, v_image): ([f32; 2], Vec<f32>)| [values.to_vec(), v_image].concat();
    let on_gpu = |data: &[f32]| {
        let (image, reference) = split(data);
        joined(on_gpu(&gpu, &image, &reference, both, 7, Accumulate::Overwrite))
    };
    let on_host = |data: &[f32]| {
        let (image, reference) = split(data);
        joined(on_host(&image, &reference, both, 7, Accumulate::Overwrite))
    };
    // Both values and the own slope; fourth channels and pixels outside the range are not read.
    let reach = poison::spread(&clean, &[20, 19, 9, 40 + 5, 40 + 7, 40 + 33], (1e-6, 1e-5), on_gpu, on_host);
    assert_eq!(reach, [3, 0, 0, 3, 0, 0], "image, then reference");

    let (x, mut v_x) = (upload(&gpu, &[0.0; 40]), upload(&gpu, &[0.0; 40]));
    let mut values = upload(&gpu, &[0.0; 3]);
    let mut scratch = SumScratch::new(&gpu, 10).expect("scratch");
    let pair = PixelPair { image: &x, image_px: 3, reference: &x, reference_px: 0, num_px: 8 };
    let mut rec = gpu.recorder().expect("recorder");
    let to = term(&mut values, 1.0, Accumulate::Add);
    let refused = step(&mut rec, &pair, both, Some(&mut v_x), to, &mut scratch);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "image", .. })), "{refused:?}");
    let pair = PixelPair { image_px: 0, num_px: 10, ..pair };
    let mut tiny = SumScratch::new(&gpu, 0).expect("scratch");
    let to = term(&mut values, 1.0, Accumulate::Add);
    let refused = step(&mut rec, &pair, both, Some(&mut v_x), to, &mut tiny);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "scratch", .. })), "{refused:?}");
    let mut short = upload(&gpu, &[0.0; 2]);
    let to = term(&mut short, 1.0, Accumulate::Add);
    let refused = step(&mut rec, &pair, both, Some(&mut v_x), to, &mut scratch);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "values", .. })), "{refused:?}");
}
