//! probe/mul_add: GPU against the twin, and the twin against the chain's closed form.

use guard4d_kernels::probe::mul_add::{CHAINS, Chains, STEPS, run};
use guard4d_kernels::reference::probe::mul_add as twin;
use guard4d_kernels::{Device, KernelError};

use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::random::Random;

const SHORT: Chains = Chains { runs: 2, scale: 0.5, shift: 1.0 };

fn on_device(device: &Device, chains: Chains, x: &[f32]) -> Vec<f32> {
    let x = device.buffer_from("x", x).expect("buffer");
    let mut y = device.buffer("y", x.len()).expect("buffer");
    let mut rec = device.recorder().expect("recorder");
    run(&mut rec, chains, &x, &mut y).expect("records");
    rec.submit().expect("runs");
    y.read().expect("read")
}

fn on_host(chains: Chains, x: &[f32]) -> Vec<f32> {
    let steps = STEPS as usize * usize::from(chains.runs);
    twin::run(CHAINS, steps, chains.scale, chains.shift, x)
}

#[test]
fn twin_follows_the_geometric_series() {
    let (scale, shift, steps) = (0.9f64, 0.3, 7);
    let power = scale.powi(steps as i32);
    let want: f64 = (0..CHAINS).map(|c| (2.5 + c as f64) * power + shift * (1.0 - power) / (1.0 - scale)).sum();
    let got = twin::run(CHAINS, steps, scale, shift, &[2.5]);
    // A handful of f64 roundings of values near 100.
    assert!((got[0] - want).abs() < 1e-12, "{} and {want}", got[0]);
}

#[test]
fn gpu_follows_the_twin_at_odd_sizes() {
    let Some(gpu) = device() else { return };
    // Slow decay, so that the starts still show after 64 steps.
    let slow = Chains { scale: 0.99, shift: 0.01, ..SHORT };
    for n in [0, 1, 63, 64, 65, 1000] {
        let x = Random(n as u64).vec_f32(n, -4.0, 4.0);
        for chains in [SHORT, slow] {
            // The driver may fuse: half an ulp of each of 64 steps, of values below 16, summed over the chains.
            assert_close(&on_device(&gpu, chains, &x), &on_host(chains, &x), 1e-4, 1e-5);
        }
    }
}

#[test]
fn poison_stays_in_its_own_element() {
    let Some(gpu) = device() else { return };
    let y = on_device(&gpu, SHORT, &[f32::NAN, f32::INFINITY, 1e-40, 1.0]);
    assert!(y[0].is_nan() && y[1] == f32::INFINITY, "{y:?}");
    // Every chain has reached its fixed point shift / (1 - scale) = 2.
    assert_close(&y[2..], &[2.0 * CHAINS as f32; 2], 1e-5, 0.0);
}

#[test]
fn no_runs_and_wrong_lengths_are_refused() {
    let Some(gpu) = device() else { return };
    let x = gpu.buffer::<f32>("x", 4).expect("buffer");
    let mut short = gpu.buffer::<f32>("y", 3).expect("buffer");
    let mut rec = gpu.recorder().expect("recorder");
    let error = run(&mut rec, SHORT, &x, &mut short);
    assert!(matches!(error, Err(KernelError::Shape { buffer: "y", .. })), "{error:?}");
    let mut y = gpu.buffer::<f32>("y", 4).expect("buffer");
    let error = run(&mut rec, Chains { runs: 0, ..SHORT }, &x, &mut y);
    assert!(matches!(error, Err(KernelError::Shape { buffer: "runs", .. })), "{error:?}");
}

#[test]
fn flops_count_both_operations() {
    let want = 2.0 * (CHAINS * 2 * 10) as f64 * f64::from(STEPS);
    assert!((SHORT.flops(10) - want).abs() < 0.5, "{} and {want}", SHORT.flops(10));
}
