//! image/noise: twin against differences, GPU against the twin, statistics, reproducibility.

use guard4d_kernels::image::noise::{Noise, backward, forward};
use guard4d_kernels::reference::image::noise as twin;

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

const NOISE: Noise = Noise { sigma: 0.05, seed: 0x1234_5678_9abc_def0, stream: 7 };

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(4);
    let (x, v_y) = (random.vec(80, 0.0, 1.0), random.vec(80, -1.0, 1.0));
    let weights: Vec<f64> = v_y.iter().enumerate().map(|(i, v)| if i % 4 < 3 { *v } else { 0.0 }).collect();
    let f = |x: &[f64]| dot(&twin::forward(0.05, 7, NOISE.seed, x), &weights);
    let worst = gradcheck(f, &x, &twin::backward(0.05, 7, NOISE.seed, &x, &v_y));
    assert!(worst < 1e-6, "{worst}");
}

fn noisy(gpu: &Gpu, noise: Noise, data: &[f32]) -> Vec<f32> {
    let x = upload(gpu, data);
    let mut y = unwritten(gpu, data.len());
    run(gpu, |rec| forward(rec, &noise, &x, &mut y));
    y.read().expect("read")
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for n in [0, 1, 100] {
        let mut random = Random(n as u64);
        let (data, v_data) = (random.vec_f32(n * 4, 0.0, 1.0), random.vec_f32(n * 4, -1.0, 1.0));
        // The driver's log is 1.7e-7 off near 1, which the root turns into 6e-4 of sigma.
        assert_close(&noisy(&gpu, NOISE, &data), &twin::forward(0.05, 7, NOISE.seed, &data), 1e-3 * 0.05, 0.0);
        let (x, v_y) = (upload(&gpu, &data), upload(&gpu, &v_data));
        let mut v_x = unwritten(&gpu, n * 4);
        run(&gpu, |rec| backward(rec, &NOISE, &x, &v_y, &mut v_x));
        assert_close(&v_x.read().expect("read"), &twin::backward(0.05, 7, NOISE.seed, &data, &v_data), 0.0, 0.0);
    }
}

#[test]
fn noise_is_reproducible_normal_and_different_per_stream_and_seed() {
    let Some(gpu) = device() else { return };
    let grey = vec![0.5f32; 20_000 * 4];
    let first = noisy(&gpu, NOISE, &grey);
    assert_eq!(first, noisy(&gpu, NOISE, &grey), "the same noise twice");
    let moments = |y: &[f32], z: &[f32]| -> f64 {
        let both = y.chunks_exact(4).zip(z.chunks_exact(4)).flat_map(|(y, z)| (0..3).map(move |c| (y[c], z[c])));
        both.map(|(y, z)| f64::from(y - 0.5) * f64::from(z - 0.5)).sum::<f64>() / 60_000.0 / (0.05 * 0.05)
    };
    let mean: f64 = first.chunks_exact(4).flat_map(|p| &p[..3]).map(|v| f64::from(v - 0.5)).sum::<f64>() / 60_000.0;
    // Standard errors over 60,000 values: 1/245 of sigma for the mean, 1/173 for the variance; bounds at five of them.
    assert!(mean.abs() < 5.0 * 0.05 / 245.0, "mean {mean}");
    assert!((moments(&first, &first) - 1.0).abs() < 5.0 / 173.0, "variance {}", moments(&first, &first));
    for other in [Noise { stream: 8, ..NOISE }, Noise { seed: NOISE.seed ^ (1 << 40), ..NOISE }] {
        let correlation = moments(&first, &noisy(&gpu, other, &grey));
        assert!(correlation.abs() < 5.0 / 245.0, "{other:?} is independent: {correlation}");
    }
}

#[test]
fn poison_stays_in_its_value() {
    let Some(gpu) = device() else { return };
    let y = noisy(&gpu, NOISE, &[f32::NAN, f32::INFINITY, 1e-40, 0.25]);
    assert!(y[0].is_nan() && y[1] == 1.0 && y[2].is_finite() && y[3] == 0.25, "{y:?}");
}
