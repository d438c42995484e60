//! nn/activation

use guard4d_kernels::nn::activation::{Activation, backward, forward};
use guard4d_kernels::reference::nn::activation as twin;
use guard4d_kernels::{Device, KernelError};

use super::{both_ways, dot, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

const ALL: [Activation; 4] = [Activation::Identity, Activation::Relu, Activation::QuickGelu, Activation::Gelu];

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(1);
    // Every probe stays clear of ReLU's kink at 0 by more than the difference step.
    let x: Vec<f64> = random.vec(40, -4.0, 4.0).into_iter().filter(|v| v.abs() > 1e-3).collect();
    let v_y = random.vec(x.len(), -1.0, 1.0);
    for act in ALL {
        let error = gradcheck(|x| dot(&twin::forward(act, x), &v_y), &x, &twin::backward(act, &x, &v_y));
        assert!(error < 1e-6, "{act:?}: {error}");
    }
}

#[test]
fn twin_erf_has_known_values() {
    // Abramowitz & Stegun 1964, table 7.1.
    for (x, want) in [(0.5f64, 0.520_499_877_813_047), (1.0, 0.842_700_792_949_715), (2.0, 0.995_322_265_018_953)] {
        assert!((twin::erf(x) - want).abs() < 1e-14, "erf({x})");
        assert!((twin::erf(-x) + want).abs() < 1e-14, "erf(-{x})");
    }
}

/// y and v_x.
fn on_gpu(gpu: &Device, act: Activation, x: &[f32], v_y: &[f32]) -> [Vec<f32>; 2] {
    both_ways(gpu, x, v_y, |rec, [x, v_y], [y, v_x]| {
        forward(rec, act, x, y)?;
        backward(rec, act, x, v_y, v_x)
    })
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for n in [0, 4, 8, 260, 1004] {
        let mut random = Random(n as u64);
        let (x, v_y) = (random.vec_f32(n, -8.0, 8.0), random.vec_f32(n, -1.0, 1.0));
        for act in ALL {
            let [y, v_x] = on_gpu(&gpu, act, &x, &v_y);
            // erf of A&S 7.1.26 is off by 1.5e-7, times |x| <= 8; exp is off by 4e-6 relative on lavapipe.
            assert_close(&y, &twin::forward(act, &x), 2e-6, 5e-6);
            assert_close(&v_x, &twin::backward(act, &x, &v_y), 4e-6, 5e-6);
        }
    }
}

#[test]
fn poison_shows_and_stays_in_its_element() {
    let Some(gpu) = device() else { return };
    let mut clean = Random(3).vec_f32(16, -2.0, 2.0);
    clean[0] = -100.0;
    for act in ALL {
        let on_gpu = |data: &[f32]| on_gpu(&gpu, act, &data[..8], &data[8..]).concat();
        let on_host = |data: &[f32]| {
            let (x, v_y) = data.split_at(8);
            [twin::forward(act, x), twin::backward(act, x, v_y)].concat()
        };
        // As above.
        let reach = poison::spread(&clean, &[1, 10], (4e-6, 5e-6), on_gpu, on_host);
        // Only a curved activation has a slope that depends on x.
        let curved = usize::from(matches!(act, Activation::QuickGelu | Activation::Gelu));
        assert_eq!(reach, [1 + curved, 1], "{act:?}: x, v_y");
    }
}

#[test]
fn wrong_lengths_are_refused() {
    let Some(gpu) = device() else { return };
    let (x, short) = (upload(&gpu, &[1.0; 8]), upload(&gpu, &[1.0; 7]));
    let mut y = unwritten(&gpu, 4);
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = forward(&mut rec, Activation::Relu, &x, &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "y", .. })), "{wrong:?}");
    let odd = forward(&mut rec, Activation::Relu, &short, &mut y);
    assert!(matches!(odd, Err(KernelError::Shape { buffer: "x", .. })), "{odd:?}");
}
