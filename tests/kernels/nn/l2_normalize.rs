//! nn/l2_normalize

use guard4d_kernels::nn::l2_normalize::{backward, forward};
use guard4d_kernels::reference::nn::l2_normalize as twin;
use guard4d_kernels::{Device, KernelError};

use super::{both_ways, dot, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
use crate::support::random::Random;

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(11);
    let (x, v_y) = (random.vec(12, -1.0, 1.0), random.vec(12, -1.0, 1.0));
    let error = gradcheck(|x| dot(&twin::forward(x, 4), &v_y), &x, &twin::backward(&x, &v_y, 4));
    assert!(error < 1e-6, "{error}");
}

/// y and v_x.
fn on_gpu(gpu: &Device, width: usize, x: &[f32], v_y: &[f32]) -> [Vec<f32>; 2] {
    both_ways(gpu, x, v_y, |rec, [x, v_y], [y, v_x]| {
        forward(rec, x, width, y)?;
        backward(rec, x, v_y, width, v_x)
    })
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (rows, width) in [(0, 4), (1, 4), (9, 36), (24, 512)] {
        let mut random = Random(width as u64);
        let (x, v_y) = (random.vec_f32(rows * width, -1.0, 1.0), random.vec_f32(rows * width, -1.0, 1.0));
        let [y, v_x] = on_gpu(&gpu, width, &x, &v_y);
        // A sum of at most 512 squares in another order: relative error below 512 * 2^-24.
        assert_close(&y, &twin::forward(&x, width), 1e-6, 1e-5);
        assert_close(&v_x, &twin::backward(&x, &v_y, width), 1e-5, 1e-5);
    }
}

#[test]
fn a_zero_row_gives_nan_and_poison_stays_in_its_row() {
    let Some(gpu) = device() else { return };
    let [y, v_x] = on_gpu(&gpu, 4, &[0.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 4.0], &[1.0; 8]);
    assert!(y[..4].iter().chain(&v_x[..4]).all(|v| v.is_nan()), "{y:?} {v_x:?}");
    // 3/5 and 4/5, one rounding each.
    assert_close(&y[4..], &[0.6, 0.0, 0.0, 0.8], 1e-6, 0.0);

    let clean = Random(12).vec_f32(48, -1.0, 1.0);
    let on_gpu = |data: &[f32]| on_gpu(&gpu, 8, &data[..24], &data[24..]).concat();
    let on_host = |data: &[f32]| {
        let (x, v_y) = data.split_at(24);
        [twin::forward(x, 8), twin::backward(x, v_y, 8)].concat()
    };
    // As above with rows of 8.
    let reach = poison::spread(&clean, &[9, 24 + 10], (1e-5, 1e-5), on_gpu, on_host);
    assert_eq!(reach, [16, 8], "x: the row of both outputs; v_y: that of one");
}

#[test]
fn wrong_lengths_are_refused() {
    let Some(gpu) = device() else { return };
    let (x, mut y) = (upload(&gpu, &[1.0; 10]), unwritten(&gpu, 10));
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = forward(&mut rec, &x, 4, &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "x", .. })), "{wrong:?}");
}
