//! loss/lpips: twin against differences, GPU against the twin, poison.

use guard4d_kernels::KernelError;
use guard4d_kernels::loss::lpips::{LpipsSums, Tap, step};
use guard4d_kernels::nn::activation::Activation;
use guard4d_kernels::reference::loss::lpips as twin;
use guard4d_kernels::reference::nn::activation as relu;
use guard4d_kernels::shape::Accumulate;

use super::{run, term, upload};
use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

#[test]
fn twin_gradient_matches_differences() {
    let (rows, channels) = (5, 8);
    let mut random = Random(1);
    // Inputs of the ReLU; a difference of 1e-5 crosses no kink.
    let x: Vec<f64> = random.vec(rows * channels, -1.0, 1.0).iter().map(|v| v + 1e-3 * v.signum()).collect();
    let (y, weight) = (random.vec(rows * channels, 0.0, 1.0), random.vec(channels, 0.0, 1.0));
    let value = |x: &[f64]| twin::step(&relu::forward(Activation::Relu, x), &y, &weight).0;
    let (_, grad) = twin::step(&relu::forward(Activation::Relu, &x), &y, &weight);
    let worst = gradcheck(value, &x, &grad);
    assert!(worst < 1e-6, "{worst}");
}

/// Mean over twice as many pixels as there are.
fn mean_over(rows: usize) -> usize {
    2 * rows.max(1)
}

/// Value and gradient with twice the weight, on top of 0.5.
fn on_gpu(gpu: &Gpu, [features, weight]: [&[f32]; 2], accumulate: Accumulate) -> Vec<f32> {
    let rows = features.len() / 2 / weight.len();
    let (features, reference) = features.split_at(features.len() / 2);
    let mut v_features = upload(gpu, &vec![0.5; features.len()]);
    let [features, reference, weight] = [features, reference, weight].map(|data| upload(gpu, data));
    let mut values = upload(gpu, &[7.0; 3]);
    let mut sums = LpipsSums::new(gpu, rows).expect("sums");
    run(gpu, |rec| {
        let tap = Tap { features: &features, reference: &reference, weight: &weight, rows, mean_over: mean_over(rows) };
        step(rec, &tap, &mut v_features, term(&mut values, 2.0, accumulate), &mut sums)
    });
    let values = values.read().expect("read");
    assert_eq!([values[0], values[2]], [7.0; 2], "other slots are untouched");
    [vec![values[1]], v_features.read().expect("read")].concat()
}

fn on_host([features, weight]: [&[f32]; 2], accumulate: Accumulate) -> Vec<f32> {
    let (x, y) = features.split_at(features.len() / 2);
    let mean = 1.0 / mean_over(x.len() / weight.len()) as f32;
    let (value, v_x) = twin::step(x, y, weight);
    let before = if accumulate == Accumulate::Add { 0.5 } else { 0.0 };
    let gated = x.iter().zip(v_x).map(|(x, v)| if *x <= 0.0 { 0.0 } else { before + 2.0 * mean * v });
    std::iter::once(mean * value).chain(gated).collect()
}

/// Features behind a ReLU: many are zero.
fn features(rows: usize, channels: usize) -> Vec<f32> {
    Random((rows + channels) as u64).vec_f32(2 * rows * channels, -0.5, 1.0).iter().map(|v| v.max(0.0)).collect()
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (rows, channels) in [(0, 4), (1, 4), (7, 8), (64, 12), (65, 64), (300, 4)] {
        let mut features = features(rows, channels);
        if rows > 2 {
            // Dead pixels: of the picture, of the reference, of both.
            features[..channels].fill(0.0);
            features[(rows + 1) * channels..][..channels].fill(0.0);
            features[2 * channels..3 * channels].fill(0.0);
            features[(rows + 2) * channels..][..channels].fill(0.0);
        }
        let weight = Random(9).vec_f32(channels, 0.0, 1.0);
        for accumulate in [Accumulate::Overwrite, Accumulate::Add] {
            let data = [features.as_slice(), weight.as_slice()];
            // Up to 64 terms in another order, and a mean of at most 300.
            assert_close(&on_gpu(&gpu, data, accumulate), &on_host(data, accumulate), 2e-6, 1e-5);
        }
    }
}

#[test]
fn poison_stays_in_its_pixel() {
    let Some(gpu) = device() else { return };
    let (rows, channels) = (9, 8);
    let len = 2 * rows * channels;
    // All above zero, so that the ReLU hides nothing.
    let clean = Random(4).vec_f32(len + channels, 0.1, 1.0);
    let on_gpu = |data: &[f32]| on_gpu(&gpu, [&data[..len], &data[len..]], Accumulate::Overwrite);
    let on_host = |data: &[f32]| on_host([&data[..len], &data[len..]], Accumulate::Overwrite);
    let places = [channels + 2, (rows + 3) * channels];
    let reach = poison::spread(&clean, &places, (2e-6, 1e-5), on_gpu, on_host);
    assert_eq!(reach, [1 + channels, 1 + channels], "the value, and the gradient of one pixel");
}

#[test]
fn what_does_not_fit_is_refused() {
    let Some(gpu) = device() else { return };
    let (features, weight) = (upload(&gpu, &[0.0; 8]), upload(&gpu, &[1.0; 4]));
    let mut values = upload(&gpu, &[0.0; 2]);
    let (mut v_features, mut short) = (upload(&gpu, &[0.0; 8]), upload(&gpu, &[0.0; 4]));
    let mut sums = LpipsSums::new(&gpu, 2).expect("sums");
    let mut rec = gpu.recorder().expect("recorder");
    let tap = Tap { features: &features, reference: &features, weight: &weight, rows: 2, mean_over: 2 };
    let wrong = step(&mut rec, &tap, &mut short, term(&mut values, 1.0, Accumulate::Add), &mut sums);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "v_features", .. })), "{wrong:?}");
    let few = upload(&gpu, &[0.0; 4]);
    let wrong = Tap { reference: &few, ..tap };
    let wrong = step(&mut rec, &wrong, &mut v_features, term(&mut values, 1.0, Accumulate::Add), &mut sums);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "reference", .. })), "{wrong:?}");
    let tap = Tap { rows: 1, ..tap };
    let wrong = step(&mut rec, &tap, &mut v_features, term(&mut values, 1.0, Accumulate::Add), &mut sums);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "features", .. })), "{wrong:?}");
    let odd = upload(&gpu, &[1.0; 6]);
    let tap = Tap { weight: &odd, ..tap };
    let wrong = step(&mut rec, &tap, &mut v_features, term(&mut values, 1.0, Accumulate::Add), &mut sums);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "weight", .. })), "{wrong:?}");
}
