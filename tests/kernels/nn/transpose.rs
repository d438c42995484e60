//! nn/transpose

use guard4d_kernels::KernelError;
use guard4d_kernels::nn::transpose::copy;
use guard4d_kernels::reference::nn::transpose as twin;

use super::{run, unwritten, upload};
use crate::support::gpu::device;
use crate::support::poison;
use crate::support::random::Random;

#[test]
fn gpu_equals_the_twin_poison_included() {
    let Some(gpu) = device() else { return };
    for (rows, cols) in [(1, 1), (4, 8), (5, 3), (66, 31)] {
        let x = Random(rows as u64).vec_f32(rows * cols, -1.0, 1.0);
        let on_gpu = |x: &[f32]| {
            let (x, mut y) = (upload(&gpu, x), unwritten(&gpu, cols * rows.next_multiple_of(4)));
            run(&gpu, |rec| copy(rec, &x, rows, cols, &mut y));
            y.read().expect("read")
        };
        // Copies. The last element stands beside the padding.
        let reach = poison::spread(&x, &[0, x.len() - 1], (0.0, 0.0), on_gpu, |x| twin::copy(x, rows, cols));
        assert_eq!(reach, [1, 1], "{rows} x {cols}: its own place");
    }
}

#[test]
fn poison_does_not_reach_the_padding() {
    let Some(gpu) = device() else { return };
    let (x, mut y) = (upload(&gpu, &[f32::NAN; 5]), unwritten(&gpu, 8));
    run(&gpu, |rec| copy(rec, &x, 5, 1, &mut y));
    let y = y.read().expect("read");
    assert!(y[..5].iter().all(|v| v.is_nan()) && y[5..] == [0.0; 3], "{y:?}");
}

#[test]
fn wrong_lengths_are_refused_and_empty_is_fine() {
    let Some(gpu) = device() else { return };
    let (x, mut y, mut none) = (upload(&gpu, &[1.0; 6]), unwritten(&gpu, 6), unwritten(&gpu, 0));
    let mut rec = gpu.recorder().expect("recorder");
    let wrong = copy(&mut rec, &x, 3, 2, &mut y);
    assert!(matches!(wrong, Err(KernelError::Shape { buffer: "y", .. })), "{wrong:?}");
    let empty = upload(&gpu, &[]);
    run(&gpu, |rec| copy(rec, &empty, 3, 0, &mut none));
}
