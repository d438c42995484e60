//! nn/row_mean

use guard4d_kernels::KernelError;
use guard4d_kernels::nn::row_mean::forward;
use guard4d_kernels::reference::nn::row_mean as twin;

use super::{run, unwritten, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::random::Random;

#[test]
fn gpu_follows_the_twin() {
    let Some(gpu) = device() else { return };
    for (rows, width) in [(1, 4), (9, 12), (17, 256)] {
        let x = Random(rows as u64).vec_f32(rows * width, -1.0, 1.0);
        let (x_buffer, mut mean) = (upload(&gpu, &x), unwritten(&gpu, rows));
        run(&gpu, |rec| forward(rec, &x_buffer, width, &mut mean));
        // Sums of at most 256 values below 1 in another order, divided by their number.
        assert_close(&mean.read().expect("read"), &twin::forward(&x, width), 1e-6, 0.0);
    }
}

#[test]
fn poison_stays_in_its_row() {
    let Some(gpu) = device() else { return };
    let (x, mut mean) = (upload(&gpu, &[1.0, f32::NAN, 1.0, 1.0, 1.0, 2.0, 3.0, 4.0]), unwritten(&gpu, 2));
    run(&gpu, |rec| forward(rec, &x, 4, &mut mean));
    let mean = mean.read().expect("read");
    assert!(mean[0].is_nan() && mean[1] == 2.5, "{mean:?}");
}

#[test]
fn wrong_lengths_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let (x, mut mean, mut none) = (upload(&gpu, &[1.0; 8]), unwritten(&gpu, 3), unwritten(&gpu, 0));
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = forward(&mut rec, &x, 4, &mut mean);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "x", .. })), "{wrong:?}");
    let empty = upload(&gpu, &[]);
    run(&gpu, |rec| forward(rec, &empty, 4, &mut none));
}
