//! nn/layer_norm

use guard4d_kernels::nn::layer_norm::{LayerNorm, Rows, Upstream, backward, forward};
use guard4d_kernels::reference::nn::layer_norm as twin;
use guard4d_kernels::{Device, KernelError};

use super::{dot, run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::gradcheck::gradcheck;
use crate::support::poison;
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

fn sum(a: &[f32], b: &[f32]) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| a + b).collect()
}

/// y, v_x, and v_x with the residual added.
fn on_gpu(gpu: &Device, norm: &LayerNorm, inputs: [&[f32]; 3]) -> [Vec<f32>; 3] {
    let rows = Rows::all(inputs[0].len() / norm.width());
    let mut out = inputs.map(|data| unwritten(gpu, data.len()));
    let [x, v_y, residual] = inputs.map(|data| upload(gpu, data));
    let [y, v_x, v_sum] = &mut out;
    run(gpu, |rec| {
        forward(rec, norm, &x, rows, y)?;
        let plain = Upstream { x: &x, v_y: &v_y, v_residual: None };
        backward(rec, norm, &plain, rows, v_x)?;
        backward(rec, norm, &Upstream { v_residual: Some(&residual), ..plain }, rows, v_sum)
    });
    out.map(|buffer| buffer.read().expect("read"))
}

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (rows, width) in [(0, 4), (1, 4), (7, 64), (8, 128), (50, 36)] {
        let mut random = Random((rows * width) as u64);
        let (x, v_y) = (random.vec_f32(rows * width, -2.0, 2.0), random.vec_f32(rows * width, -1.0, 1.0));
        let (gamma, beta) = (random.vec_f32(width, 0.5, 1.5), random.vec_f32(width, -1.0, 1.0));
        let residual = random.vec_f32(rows * width, -1.0, 1.0);
        let norm = LayerNorm::new(&gpu, "norm", &gamma, &beta, EPS).expect("norm");
        let [y, v_x, v_sum] = on_gpu(&gpu, &norm, [&x, &v_y, &residual]);
        let want = twin::backward(&x, &gamma, &v_y, EPS);
        // Sums of at most 128 values of size 2 in another order: 128 * 2 * 2^-24 = 1.5e-5 at worst.
        assert_close(&y, &twin::forward(&x, &gamma, &beta, EPS), 1e-5, 1e-5);
        assert_close(&v_x, &want, 1e-5, 1e-5);
        assert_close(&v_sum, &sum(&want, &residual), 1e-5, 1e-5);
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
    let norm = LayerNorm::new(&gpu, "norm", &[1.0; 8], &[0.25; 8], EPS).expect("norm");
    let [y, v_x, _] = on_gpu(&gpu, &norm, [&[0.5; 8], &[1.0; 8], &[0.0; 8]]);
    assert_eq!((y, v_x), (vec![0.25; 8], vec![0.0; 8]), "no variance: beta, and no slope along ones");

    let clean = Random(8).vec_f32(72, -2.0, 2.0);
    let on_gpu = |data: &[f32]| on_gpu(&gpu, &norm, [&data[..24], &data[24..48], &data[48..]]).concat();
    let on_host = |data: &[f32]| {
        let v_x = twin::backward(&data[..24], &[1.0; 8], &data[24..48], EPS);
        let v_sum = sum(&v_x, &data[48..]);
        [twin::forward(&data[..24], &[1.0; 8], &[0.25; 8], EPS), v_x, v_sum].concat()
    };
    // As above.
    let reach = poison::spread(&clean, &[9, 24 + 9, 48 + 9], (1e-5, 1e-5), on_gpu, on_host);
    assert_eq!(reach, [24, 16, 1], "x: the row of all outputs; v_y: that of both gradients; the residual: itself");
}

#[test]
fn wrong_lengths_are_refused() {
    let Some(gpu) = device() else { return };
    let odd = LayerNorm::new(&gpu, "norm", &[1.0; 6], &[0.0; 6], EPS);
    assert!(matches!(odd, Err(KernelError::Shape { buffer: "gamma", .. })), "{odd:?}");
    let norm = LayerNorm::new(&gpu, "norm", &[1.0; 8], &[0.0; 8], EPS).expect("norm");
    let (x, mut y) = (upload(&gpu, &[1.0; 16]), unwritten(&gpu, 24));
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = forward(&mut rec, &norm, &x, Rows::all(3), &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "x", .. })), "{wrong:?}");
}
