//! nn/axpy: twin against differences, GPU against the twin.

use guard4d_kernels::nn::axpy::{backward, forward};
use guard4d_kernels::reference::nn::axpy as twin;

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(1);
    let (x, delta, v_y) = (random.vec(9, -1.0, 1.0), random.vec(9, -1.0, 1.0), random.vec(9, -1.0, 1.0));
    let worst = gradcheck(|d| dot(&twin::forward(0.1, &x, d), &v_y), &delta, &twin::backward(0.1, &v_y));
    assert!(worst < 1e-6, "{worst}");
}

#[test]
fn gpu_follows_the_twin_poison_included() {
    let Some(gpu) = device() else { return };
    for n in [0, 1, 65, 300] {
        let mut random = Random(n as u64);
        let (a, mut b) = (random.vec_f32(n * 4, -1.0, 1.0), random.vec_f32(n * 4, -1.0, 1.0));
        if n > 0 {
            (b[0], b[1], b[2]) = (f32::NAN, f32::INFINITY, 1e-40);
        }
        let (x, delta) = (upload(&gpu, &a), upload(&gpu, &b));
        let (mut y, mut v_delta) = (unwritten(&gpu, n * 4), unwritten(&gpu, n * 4));
        run(&gpu, |rec| {
            forward(rec, 0.1, &x, &delta, &mut y)?;
            backward(rec, 0.1, &delta, &mut v_delta)
        });
        for (got, want) in [(y, twin::forward(0.1, &a, &b)), (v_delta, twin::backward(0.1, &b))] {
            let got = got.read().expect("read");
            assert!(n == 0 || got[0].is_nan() && got[1].is_infinite(), "poison shows");
            // One product and one sum.
            assert_close(got.get(2..).unwrap_or(&[]), want.get(2..).unwrap_or(&[]), 1e-7, 1e-6);
        }
    }
}
