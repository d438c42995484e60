//! optim/adam: GPU against the twin, and the twin against the update's closed form.

use guard4d_kernels::optim::adam::{AdamConfig, AdamState, RowRates, Tail, step};
use guard4d_kernels::reference::optim::adam as twin;
use guard4d_kernels::{KernelError, Recorder};

use crate::support::close::assert_close;
use crate::support::golden::Golden;
use crate::support::gpu::{Gpu, device};
use crate::support::random::Random;

fn twin_config(config: &AdamConfig, t: i32) -> twin::Adam<'static, f32> {
    let AdamConfig { lr, beta1, beta2, eps, keep, bound, tail } = *config;
    let tail = tail.map(|t| (t.row, t.head, t.lr));
    twin::Adam {
        lr,
        beta1,
        beta2,
        eps,
        bias1: 1.0 - beta1.powi(t),
        bias2: 1.0 - beta2.powi(t),
        keep,
        bound,
        tail,
        rates: None,
    }
}

fn run(gpu: &Gpu, record: impl FnOnce(&mut Recorder) -> Result<(), KernelError>) {
    let mut rec = gpu.recorder().expect("recorder");
    record(&mut rec).expect("records");
    rec.submit().expect("runs");
}

#[test]
fn first_step_moves_each_parameter_by_lr_against_its_gradient() {
    // At t = 1 both bias corrections cancel: the step is lr g / (|g| + eps).
    let (bias1, bias2) = (1.0 - 0.9, 1.0 - 0.999);
    let (beta1, beta2) = (0.9, 0.999);
    let (keep, bound) = (1.0, f64::INFINITY);
    let mut config = twin::Adam { lr: 0.1, beta1, beta2, eps: 0.0, bias1, bias2, keep, bound, tail: None, rates: None };
    let mut param = [1.0f64, -2.0];
    twin::step(&config, &mut param, &[3.0, -0.5], &mut [0.0; 2], &mut [0.0; 2]);
    assert!((param[0] - 0.9).abs() < 1e-12 && (param[1] + 1.9).abs() < 1e-12, "{param:?}");
    config.tail = Some((3, 1, 0.5));
    let mut param = [0.0f64; 6];
    twin::step(&config, &mut param, &[1.0; 6], &mut [0.0; 6], &mut [0.0; 6]);
    let want = [-0.1, -0.5, -0.5, -0.1, -0.5, -0.5];
    assert!(param.iter().zip(want).all(|(p, w)| (p - w).abs() < 1e-12), "two groups: {param:?}");
    config.rates = Some((3, &[0.0, 2.0]));
    let mut param = [0.0f64; 6];
    twin::step(&config, &mut param, &[1.0; 6], &mut [0.0; 6], &mut [0.0; 6]);
    let want = [0.0, 0.0, 0.0, -0.2, -1.0, -1.0];
    assert!(param.iter().zip(want).all(|(p, w)| (p - w).abs() < 1e-12), "a still row and a fast one: {param:?}");
    config.bound = 0.3;
    let mut param = [0.0f64; 6];
    twin::step(&config, &mut param, &[1.0, -1.0, 1.0, 1.0, -1.0, 1.0], &mut [0.0; 6], &mut [0.0; 6]);
    let want = [0.0, 0.0, 0.0, -0.2, 0.3, -0.3];
    assert!(param.iter().zip(want).all(|(p, w)| (p - w).abs() < 1e-12), "within the bound: {param:?}");
}

#[test]
fn gpu_follows_the_twin_over_ten_steps() {
    let Some(gpu) = device() else { return };
    let one = AdamConfig { lr: 0.05, keep: 0.98, ..AdamConfig::default() };
    let two = AdamConfig { tail: Some(Tail { row: 7, head: 3, lr: 0.002 }), ..one };
    for (n, config) in [(1, one), (63, two), (64, one), (700, two), (1000, one)] {
        let mut random = Random(n as u64);
        let mut want = random.vec_f32(n, -1.0, 1.0);
        let (mut m, mut v) = (vec![0.0; n], vec![0.0; n]);
        let mut param = gpu.buffer_from("param", &want).expect("buffer");
        let mut state = AdamState::new(&gpu, "param", n).expect("state");
        for t in 1..=10 {
            let grad = random.vec_f32(n, -1.0, 1.0);
            let v_param = gpu.buffer_from("v_param", &grad).expect("buffer");
            run(&gpu, |rec| step(rec, &mut param, &v_param, &mut state, &config));
            twin::step(&twin_config(&config, t), &mut want, &grad, &mut m, &mut v);
        }
        // Ten steps of four roundings each, amplified by at most lr / sqrt(v): well under 1e-5.
        assert_close(&param.read().expect("read"), &want, 1e-5, 0.0);
        assert_close(&state.exp_avg.read().expect("read"), &m, 1e-6, 0.0);
        assert_close(&state.exp_avg_sq.read().expect("read"), &v, 1e-6, 0.0);
    }
}

#[test]
fn gpu_follows_the_twin_at_rates_of_rows_and_a_rate_of_zero_moves_nothing() {
    let Some(gpu) = device() else { return };
    let one = AdamConfig { lr: 0.05, keep: 0.98, ..AdamConfig::default() };
    let two = AdamConfig { tail: Some(Tail { row: 7, head: 3, lr: 0.002 }), ..one };
    for (row, rows, config) in [(4, 1, one), (4, 130, one), (7, 33, two), (1, 65, one)] {
        let n = row * rows;
        let mut random = Random(n as u64);
        let mut factors = random.vec_f32(rows, 0.1, 3.0);
        factors.iter_mut().step_by(3).for_each(|factor| *factor = 0.0);
        let mut want = vec![0.0; n];
        let (mut m, mut v) = (vec![0.0; n], vec![0.0; n]);
        let mut param = gpu.buffer_from("param", &want).expect("buffer");
        let mut state = AdamState::new(&gpu, "param", n).expect("state");
        state.rates = Some(RowRates { row, factors: gpu.buffer_from("rates", &factors).expect("buffer") });
        for t in 1..=10 {
            let grad = random.vec_f32(n, -1.0, 1.0);
            let v_param = gpu.buffer_from("v_param", &grad).expect("buffer");
            run(&gpu, |rec| step(rec, &mut param, &v_param, &mut state, &config));
            let twin = twin::Adam { rates: Some((row, &factors[..])), ..twin_config(&config, t) };
            twin::step(&twin, &mut want, &grad, &mut m, &mut v);
        }
        let got = param.read().expect("read");
        // As without rates, times the largest factor.
        assert_close(&got, &want, 3e-5, 0.0);
        let (still, moved): (Vec<_>, Vec<_>) = got.chunks_exact(row).zip(&factors).partition(|(_, f)| **f == 0.0);
        assert!(still.iter().all(|(p, _)| p.iter().all(|p| *p == 0.0)), "rows of {row} at rate 0: {still:?}");
        assert!(moved.iter().all(|(p, _)| p.iter().all(|p| *p != 0.0)), "rows of {row} at other rates: {moved:?}");
        assert_close(&state.exp_avg.read().expect("read"), &m, 1e-6, 0.0);
    }
    let mut param = gpu.buffer::<f32>("param", 8).expect("buffer");
    let v_param = gpu.buffer::<f32>("v_param", 8).expect("buffer");
    let mut state = AdamState::new(&gpu, "param", 8).expect("state");
    let mut rec = gpu.recorder().expect("recorder");
    let tail = Some(Tail { row: 8, head: 1, lr: 0.1 });
    for (row, len, tail, named) in [(4, 3, None, "rates"), (3, 2, None, "param"), (4, 2, tail, "param")] {
        state.rates = Some(RowRates { row, factors: gpu.buffer("rates", len).expect("buffer") });
        let refused = step(&mut rec, &mut param, &v_param, &mut state, &AdamConfig { tail, ..one });
        assert!(matches!(refused, Err(KernelError::Shape { buffer, .. }) if buffer == named), "{named}: {refused:?}");
    }
    assert_eq!(state.steps, 0, "a refused step does not count");
}

#[test]
fn steps_end_within_the_bound_and_follow_the_twin_there() {
    let Some(gpu) = device() else { return };
    let mut random = Random(29);
    // One element beside the texels.
    let n = 4099;
    let mut want = vec![0.0f32; n];
    let mut param = gpu.buffer::<f32>("param", n).expect("buffer");
    let (mut m, mut v) = (vec![0.0f32; n], vec![0.0f32; n]);
    let mut state = AdamState::new(&gpu, "param", n).expect("state");
    let config = AdamConfig { lr: 0.1, bound: 0.25, ..AdamConfig::default() };
    for t in 1..=6 {
        let grad = random.vec_f32(n, -1.0, 1.0);
        let v_param = gpu.buffer_from("v_param", &grad).expect("buffer");
        run(&gpu, |rec| step(rec, &mut param, &v_param, &mut state, &config));
        twin::step(&twin_config(&config, t), &mut want, &grad, &mut m, &mut v);
    }
    let got = param.read().expect("read");
    // As without a bound.
    assert_close(&got, &want, 3e-5, 0.0);
    let at = |side: f32| got.iter().filter(|p| **p == side * config.bound).count();
    assert!(got.iter().all(|p| p.abs() <= config.bound), "none beyond");
    assert!(
        at(1.0) > 10 && at(-1.0) > 10 && at(1.0) + at(-1.0) < n / 2,
        "some on either side: {} {}",
        at(1.0),
        at(-1.0)
    );
    let mut poisoned = gpu.buffer_from("param", &[f32::NAN, 1.0, 0.0, 0.0]).expect("buffer");
    let still = gpu.buffer::<f32>("v_param", 4).expect("buffer");
    let mut state = AdamState::new(&gpu, "param", 4).expect("state");
    run(&gpu, |rec| step(rec, &mut poisoned, &still, &mut state, &config));
    let got = poisoned.read().expect("read");
    assert!(got[0].is_nan() && got[1..] == [0.25, 0.0, 0.0], "a bound hides no NaN: {got:?}");
}

#[test]
fn poison_stays_in_its_own_element() {
    let Some(gpu) = device() else { return };
    let mut param = gpu.buffer_from("param", &[1.0f32; 4]).expect("buffer");
    let v_param = gpu.buffer_from("v_param", &[f32::NAN, f32::INFINITY, 1e-40, 1.0]).expect("buffer");
    let mut state = AdamState::new(&gpu, "param", 4).expect("state");
    run(&gpu, |rec| step(rec, &mut param, &v_param, &mut state, &AdamConfig::default()));
    let out = param.read().expect("read");
    assert!(out[0].is_nan() && out[1].is_nan(), "NaN and Inf gradients show in the parameter: {out:?}");
    assert!(out[2].is_finite() && (out[3] - 0.999).abs() < 1e-6, "the others are untouched by them: {out:?}");
}

#[test]
fn wrong_lengths_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let mut param = gpu.buffer::<f32>("param", 4).expect("buffer");
    let short = gpu.buffer::<f32>("v_param", 3).expect("buffer");
    let mut state = AdamState::new(&gpu, "param", 4).expect("state");
    let mut rec = gpu.recorder().expect("recorder");
    let error = step(&mut rec, &mut param, &short, &mut state, &AdamConfig::default());
    assert!(matches!(error, Err(KernelError::Shape { buffer: "v_param", .. })), "{error:?}");
    let tail = Some(Tail { row: 3, head: 1, lr: 0.1 });
    let fits = gpu.buffer::<f32>("v_param", 4).expect("buffer");
    let error = step(&mut rec, &mut param, &fits, &mut state, &AdamConfig { tail, ..AdamConfig::default() });
    assert!(matches!(error, Err(KernelError::Shape { buffer: "param", .. })), "{error:?}");
    assert_eq!(state.steps, 0, "a refused step does not count");
    let mut none = gpu.buffer::<f32>("param", 0).expect("buffer");
    let v_none = gpu.buffer::<f32>("v_param", 0).expect("buffer");
    let mut state = AdamState::new(&gpu, "param", 0).expect("state");
    run(&gpu, |rec| step(rec, &mut none, &v_none, &mut state, &AdamConfig::default()));
}

#[test]
fn ten_steps_match_pytorch() {
    let golden = Golden::load("adam");
    let hyper = golden.f32("hyper");
    let config = AdamConfig { lr: hyper[0], beta1: hyper[1], beta2: hyper[2], eps: hyper[3], ..AdamConfig::default() };
    let (mut param, grads, history) = (golden.f32("param"), golden.f32("grads"), golden.f32("history"));
    let n = param.len();
    let (mut m, mut v) = (vec![0.0; n], vec![0.0; n]);
    let start = param.clone();
    for ((grad, want), t) in grads.chunks_exact(n).zip(history.chunks_exact(n)).zip(1..) {
        twin::step(&twin_config(&config, t), &mut param, grad, &mut m, &mut v);
        // A few roundings of values near 1 per step.
        assert_close(&param, want, 1e-6, 1e-6);
    }
    let Some(gpu) = device() else { return };
    let mut param = gpu.buffer_from("param", &start).expect("buffer");
    let mut state = AdamState::new(&gpu, "param", n).expect("state");
    for (grad, want) in grads.chunks_exact(n).zip(history.chunks_exact(n)) {
        let v_param = gpu.buffer_from("v_param", grad).expect("buffer");
        run(&gpu, |rec| step(rec, &mut param, &v_param, &mut state, &config));
        assert_close(&param.read().expect("read"), want, 1e-6, 1e-6);
    }
    assert_close(&state.exp_avg.read().expect("read"), &golden.f32("exp_avg"), 1e-6, 1e-6);
    assert_close(&state.exp_avg_sq.read().expect("read"), &golden.f32("exp_avg_sq"), 1e-6, 1e-6);
}
