//! nn/row_mean

use guard4d_kernels::KernelError;
use guard4d_kernels::nn::row_mean::forward;
use guard4d_kernels::reference::nn::row_mean as twin;

use super::{run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::poison;
use crate::support::random::Random;

#[test]
fn gpu_follows_the_twin_poison_included() {
    let Some(gpu) = device() else { return };
    for (rows, width) in [(1, 4), (9, 12), (17, 256)] {
        let x = Random(rows as u64).vec_f32(rows * width, -1.0, 1.0);
        let on_gpu = |x: &[f32]| {
            let (x, mut mean) = (upload(&gpu, x), unwritten(&gpu, rows));
            run(&gpu, |rec| forward(rec, &x, width, &mut mean));
            mean.read().expect("read")
        };
        // Sums of at most 256 values below 1 in another order, divided by their number.
        let reach = poison::spread(&x, &[1], (1e-6, 0.0), on_gpu, |x| twin::forward(x, width));
        assert_eq!(reach, [1], "its row");
    }
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
