//! image/noise: twin against differences, GPU against the twin, statistics, reproducibility.

use guard4d_kernels::image::noise::{Noise, backward, forward};
use guard4d_kernels::reference::image::noise as twin;

use super::{both_ways, dot};
use crate::support::close::assert_close;
use crate::support::gpu::{Gpu, device};
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
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

/// y and v_x.
fn noisy(gpu: &Gpu, noise: Noise, x: &[f32], v_y: &[f32]) -> [Vec<f32>; 2] {
    both_ways(gpu, x, v_y, |rec, [x, v_y], [y, v_x]| {
        forward(rec, &noise, x, y)?;
        backward(rec, &noise, x, v_y, v_x)
    })
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for n in [0, 1, 100] {
        let mut random = Random(n as u64);
        let (data, v_data) = (random.vec_f32(n * 4, 0.0, 1.0), random.vec_f32(n * 4, -1.0, 1.0));
        // The driver's log is 1.7e-7 off near 1, which the root turns into 6e-4 of sigma.
        let [y, v_x] = noisy(&gpu, NOISE, &data, &v_data);
        assert_close(&y, &twin::forward(0.05, 7, NOISE.seed, &data), 1e-3 * 0.05, 0.0);
        assert_close(&v_x, &twin::backward(0.05, 7, NOISE.seed, &data, &v_data), 0.0, 0.0);
    }
}

#[test]
fn noise_is_reproducible_normal_and_different_per_stream_and_seed() {
    let Some(gpu) = device() else { return };
    let grey = vec![0.5f32; 20_000 * 4];
    let noise = |noise| noisy(&gpu, noise, &grey, &grey)[0].clone();
    let first = noise(NOISE);
    assert_eq!(first, noise(NOISE), "the same noise twice");
    let moments = |y: &[f32], z: &[f32]| -> f64 {
        let both = y.chunks_exact(4).zip(z.chunks_exact(4)).flat_map(|(y, z)| (0..3).map(move |c| (y[c], z[c])));
        both.map(|(y, z)| f64::from(y - 0.5) * f64::from(z - 0.5)).sum::<f64>() / 60_000.0 / (0.05 * 0.05)
    };
    let mean: f64 = first.chunks_exact(4).flat_map(|p| &p[..3]).map(|v| f64::from(v - 0.5)).sum::<f64>() / 60_000.0;
    // Standard errors over 60,000 values: 1/245 of sigma for the mean, 1/173 for the variance; bounds at five of them.
    assert!(mean.abs() < 5.0 * 0.05 / 245.0, "mean {mean}");
    assert!((moments(&first, &first) - 1.0).abs() < 5.0 / 173.0, "variance {}", moments(&first, &first));
    for other in [Noise { stream: 8, ..NOISE }, Noise { seed: NOISE.seed ^ (1 << 40), ..NOISE }] {
        let correlation = moments(&first, &noise(other));
        assert!(correlation.abs() < 5.0 / 245.0, "{other:?} is independent: {correlation}");
    }
}

#[test]
fn poison_stays_in_its_value() {
    let Some(gpu) = device() else { return };
    // Four pixels, far enough from both ends that the noise clamps none.
    let clean = Random(6).vec_f32(32, 0.4, 0.6);
    let on_gpu = |data: &[f32]| noisy(&gpu, NOISE, &data[..16], &data[16..]).concat();
    let on_host = |data: &[f32]| {
        let (x, v_y) = data.split_at(16);
        [twin::forward(0.05, 7, NOISE.seed, x), twin::backward(0.05, 7, NOISE.seed, x, v_y)].concat()
    };
    // As above.
    let reach = poison::spread(&clean, &[5, 7, 16 + 5, 16 + 7], (1e-3 * 0.05, 0.0), on_gpu, on_host);
    assert_eq!(reach, [1, 1, 1, 0], "x and its copied fourth channel, v_y; its fourth channel is not read");
}
