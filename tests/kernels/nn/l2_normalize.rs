//! nn/l2_normalize

use guard4d_kernels::KernelError;
use guard4d_kernels::nn::l2_normalize::{backward, forward};
use guard4d_kernels::reference::nn::l2_normalize as twin;

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(11);
    let (x, v_y) = (random.vec(12, -1.0, 1.0), random.vec(12, -1.0, 1.0));
    let error = gradcheck(|x| dot(&twin::forward(x, 4), &v_y), &x, &twin::backward(&x, &v_y, 4));
    assert!(error < 1e-6, "{error}");
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (rows, width) in [(1, 4), (9, 36), (24, 512)] {
        let mut random = Random(width as u64);
        let (x, v_y) = (random.vec_f32(rows * width, -1.0, 1.0), random.vec_f32(rows * width, -1.0, 1.0));
        let (x_buffer, v_y_buffer) = (upload(&gpu, &x), upload(&gpu, &v_y));
        let (mut y, mut v_x) = (unwritten(&gpu, x.len()), unwritten(&gpu, x.len()));
        run(&gpu, |rec| {
            forward(rec, &x_buffer, width, &mut y)?;
            backward(rec, &x_buffer, &v_y_buffer, width, &mut v_x)
        });
        // A sum of at most 512 squares in another order: relative error below 512 * 2^-24.
        assert_close(&y.read().expect("read"), &twin::forward(&x, width), 1e-6, 1e-5);
        assert_close(&v_x.read().expect("read"), &twin::backward(&x, &v_y, width), 1e-5, 1e-5);
    }
}

#[test]
fn a_zero_row_and_poison_give_nan_in_their_row_only() {
    let Some(gpu) = device() else { return };
    let (x, mut y) =
        (upload(&gpu, &[0.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 4.0, 1.0, f32::NAN, 0.0, 0.0]), unwritten(&gpu, 12));
    run(&gpu, |rec| forward(rec, &x, 4, &mut y));
    let y = y.read().expect("read");
    assert!(y[..4].iter().chain(&y[8..]).all(|v| v.is_nan()), "{y:?}");
    // 3/5 and 4/5, one rounding each.
    assert_close(&y[4..8], &[0.6, 0.0, 0.0, 0.8], 1e-6, 0.0);
}

#[test]
fn wrong_lengths_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let (x, mut y) = (upload(&gpu, &[1.0; 10]), unwritten(&gpu, 10));
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = forward(&mut rec, &x, 4, &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "x", .. })), "{wrong:?}");
    let (empty, mut none) = (upload(&gpu, &[]), unwritten(&gpu, 0));
    run(&gpu, |rec| forward(rec, &empty, 4, &mut none));
}
