//! nn/column_sum

use guard4d_kernels::KernelError;
use guard4d_kernels::nn::column_sum::forward;
use guard4d_kernels::reference::nn::column_sum as twin;

use super::{run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::poison;
use crate::support::random::Random;

#[test]
fn gpu_equals_the_twin_bit_for_bit_poison_included() {
    let Some(gpu) = device() else { return };
    for (rows, width) in [(1, 4), (8, 8), (9, 12), (300, 36)] {
        let x = Random(rows as u64).vec_f32(rows * width, -1.0, 1.0);
        let on_gpu = |x: &[f32]| {
            let (x, mut sum) = (upload(&gpu, x), unwritten(&gpu, width));
            run(&gpu, |rec| forward(rec, &x, &mut sum));
            sum.read().expect("read")
        };
        // Same order, same bits.
        let reach = poison::spread(&x, &[1], (0.0, 0.0), on_gpu, |x| twin::forward(x, width));
        assert_eq!(reach, [1], "its column");
    }
}

#[test]
fn no_rows_sum_to_zero() {
    let Some(gpu) = device() else { return };
    let (empty, mut sum) = (upload(&gpu, &[]), unwritten(&gpu, 4));
    run(&gpu, |rec| forward(rec, &empty, &mut sum));
    assert_eq!(sum.read().expect("read"), [0.0; 4], "empty sum");
}

#[test]
fn wrong_lengths_are_refused() {
    let Some(gpu) = device() else { return };
    let (x, mut sum, mut odd) = (upload(&gpu, &[1.0; 9]), unwritten(&gpu, 4), unwritten(&gpu, 3));
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = forward(&mut rec, &x, &mut sum);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "x", .. })), "{wrong:?}");
    let wrong = forward(&mut rec, &x, &mut odd);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "sum", .. })), "{wrong:?}");
}
