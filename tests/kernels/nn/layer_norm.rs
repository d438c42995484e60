//! nn/layer_norm

use guard4d_kernels::KernelError;
use guard4d_kernels::nn::layer_norm::{LayerNorm, Rows, Upstream, backward, forward};
use guard4d_kernels::reference::nn::layer_norm as twin;

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::random::Random;

const EPS: f32 = 1e-5;

#[test]
fn twin_gradient_matches_differences() {
    let mut random = Random(7);
    let (x, v_y) = (random.vec(3 * 8, -2.0, 2.0), random.vec(3 * 8, -1.0, 1.0));
    let (gamma, beta) = (random.vec(8, 0.5, 1.5), random.vec(8, -1.0, 1.0));
    let eps = f64::from(EPS);
    let loss = |x: &[f64]| dot(&twin::forward(x, &gamma, &beta, eps), &v_y);
    let error = gradcheck(loss, &x, &twin::backward(&x, &gamma, &v_y, eps));
    assert!(error < 1e-6, "{error}");
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (rows, width) in [(1, 4), (7, 64), (8, 128), (50, 36)] {
        let mut random = Random((rows * width) as u64);
        let (x, v_y) = (random.vec_f32(rows * width, -2.0, 2.0), random.vec_f32(rows * width, -1.0, 1.0));
        let (gamma, beta) = (random.vec_f32(width, 0.5, 1.5), random.vec_f32(width, -1.0, 1.0));
        let residual = random.vec_f32(rows * width, -1.0, 1.0);
        let norm = LayerNorm::new(&gpu, "norm", &gamma, &beta, EPS).expect("norm");
        let (x_buffer, v_y_buffer, residual_buffer) = (upload(&gpu, &x), upload(&gpu, &v_y), upload(&gpu, &residual));
        let (mut y, mut v_x) = (unwritten(&gpu, rows * width), unwritten(&gpu, rows * width));
        let mut v_sum = unwritten(&gpu, rows * width);
        run(&gpu, |rec| {
            forward(rec, &norm, &x_buffer, Rows::all(rows), &mut y)?;
            let plain = Upstream { x: &x_buffer, v_y: &v_y_buffer, v_residual: None };
            backward(rec, &norm, &plain, Rows::all(rows), &mut v_x)?;
            let added = Upstream { v_residual: Some(&residual_buffer), ..plain };
            backward(rec, &norm, &added, Rows::all(rows), &mut v_sum)
        });
        let want = twin::backward(&x, &gamma, &v_y, EPS);
        let want_sum: Vec<f32> = want.iter().zip(&residual).map(|(a, b)| a + b).collect();
        // Sums of at most 128 values of size 2 in another order: 128 * 2 * 2^-24 = 1.5e-5 at worst.
        assert_close(&y.read().expect("read"), &twin::forward(&x, &gamma, &beta, EPS), 1e-5, 1e-5);
        assert_close(&v_x.read().expect("read"), &want, 1e-5, 1e-5);
        assert_close(&v_sum.read().expect("read"), &want_sum, 1e-5, 1e-5);
    }
}

#[test]
fn selected_rows_only_are_read_and_written() {
    let Some(gpu) = device() else { return };
    let (count, step, offset, width) = (3, 5, 2, 16);
    let mut random = Random(9);
    let x = random.vec_f32(count * step * width, -1.0, 1.0);
    let v_y = random.vec_f32(count * width, -1.0, 1.0);
    let (gamma, beta) = (vec![1.0; width], vec![0.0; width]);
    let norm = LayerNorm::new(&gpu, "norm", &gamma, &beta, EPS).expect("norm");
    let rows = Rows { count, step, offset };
    let (x_buffer, v_y_buffer) = (upload(&gpu, &x), upload(&gpu, &v_y));
    let (mut y, mut v_x) = (unwritten(&gpu, count * width), gpu.buffer::<f32>("v_x", x.len()).expect("buffer"));
    run(&gpu, |rec| {
        forward(rec, &norm, &x_buffer, rows, &mut y)?;
        backward(rec, &norm, &Upstream { x: &x_buffer, v_y: &v_y_buffer, v_residual: None }, rows, &mut v_x)
    });
    let picked: Vec<f32> = (0..count).flat_map(|i| x[(offset + i * step) * width..][..width].to_vec()).collect();
    let want = twin::backward(&picked, &gamma, &v_y, EPS);
    // Sums of 16 values of size 1.
    assert_close(&y.read().expect("read"), &twin::forward(&picked, &gamma, &beta, EPS), 1e-5, 1e-5);
    for (row, got) in v_x.read().expect("read").chunks_exact(width).enumerate() {
        let index = (row >= offset && (row - offset).is_multiple_of(step)).then(|| (row - offset) / step);
        match index {
            Some(i) => assert_close(got, &want[i * width..][..width], 1e-5, 1e-5),
            None => assert_eq!(got, vec![0.0; width], "row {row} is not selected"),
        }
    }
}

#[test]
fn poison_stays_in_its_row_and_a_constant_row_is_finite() {
    let Some(gpu) = device() else { return };
    let mut x = vec![0.5f32; 3 * 8];
    x[9] = f32::NAN;
    x[16] = 1e-40;
    let norm = LayerNorm::new(&gpu, "norm", &[1.0; 8], &[0.25; 8], EPS).expect("norm");
    let (x, mut y) = (upload(&gpu, &x), unwritten(&gpu, 24));
    run(&gpu, |rec| forward(rec, &norm, &x, Rows::all(3), &mut y));
    let y = y.read().expect("read");
    assert_eq!(y[..8], [0.25; 8], "no variance: beta");
    assert!(y[8..16].iter().all(|v| v.is_nan()) && y[16..].iter().all(|v| v.is_finite()), "{y:?}");
}

#[test]
fn wrong_lengths_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let odd = LayerNorm::new(&gpu, "norm", &[1.0; 6], &[0.0; 6], EPS);
    assert!(matches!(odd, Err(KernelError::Shape { buffer: "gamma", .. })), "{odd:?}");
    let norm = LayerNorm::new(&gpu, "norm", &[1.0; 8], &[0.0; 8], EPS).expect("norm");
    let (x, mut y, mut none) = (upload(&gpu, &[1.0; 16]), unwritten(&gpu, 24), unwritten(&gpu, 0));
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = forward(&mut rec, &norm, &x, Rows::all(3), &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "x", .. })), "{wrong:?}");
    run(&gpu, |rec| forward(rec, &norm, &x, Rows::all(0), &mut none));
}
