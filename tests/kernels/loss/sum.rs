//! loss/sum: GPU against the twin, odd lengths, slots, poison.

use guard4d_kernels::KernelError;
use guard4d_kernels::loss::sum::finish;
use guard4d_kernels::reference::loss::sum as twin;

use super::{run, upload};
use crate::support::close::assert_close;
use crate::support::gpu::device;
use crate::support::poison;
use crate::support::random::Random;

#[test]
fn gpu_follows_the_twin_and_touches_one_slot() {
    let Some(gpu) = device() else { return };
    for n in [0, 1, 63, 64, 65, 5000] {
        let data = Random(n as u64).vec_f32(n, -1.0, 1.0);
        let partial = upload(&gpu, &data);
        let mut values = upload(&gpu, &[7.0, 7.0, 7.0]);
        run(&gpu, |rec| finish(rec, &partial, 0..n, 0.5, &mut values, 1));
        let wide: Vec<f64> = data.iter().map(|v| f64::from(*v)).collect();
        // Lane sums of 79 values, then 64 of those: rounding of sums below 50.
        assert_close(&values.read().expect("read"), &[7.0, twin::finish(&wide, 0.5) as f32, 7.0], 2e-5, 0.0);
        run(&gpu, |rec| finish(rec, &partial, n / 3..n / 2, 0.5, &mut values, 2));
        assert_close(&values.read().expect("read")[2..], &[twin::finish(&wide[n / 3..n / 2], 0.5) as f32], 2e-5, 0.0);
    }
}

#[test]
fn poison_shows_and_wrong_slots_are_refused() {
    let Some(gpu) = device() else { return };
    let clean = Random(2).vec_f32(130, -1.0, 1.0);
    let on_gpu = |data: &[f32]| {
        let (partial, mut values) = (upload(&gpu, data), upload(&gpu, &[7.0; 2]));
        run(&gpu, |rec| finish(rec, &partial, 1..129, 0.5, &mut values, 1));
        values.read().expect("read")
    };
    let on_host = |data: &[f32]| vec![7.0, twin::finish(&data[1..129], 0.5)];
    // Sums below 130 in another order. What lies outside the range is not read.
    assert_eq!(poison::spread(&clean, &[0, 1, 128, 129], (2e-5, 0.0), on_gpu, on_host), [0, 1, 1, 0], "its slot");

    let (partial, mut values) = (upload(&gpu, &[1.0; 3]), upload(&gpu, &[0.0]));
    let mut rec = gpu.recorder().expect("recorder");
    let refused = finish(&mut rec, &partial, 0..3, 1.0, &mut values, 1);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "values", .. })), "{refused:?}");
    let refused = finish(&mut rec, &partial, 1..4, 1.0, &mut values, 0);
    assert!(matches!(refused, Err(KernelError::Shape { buffer: "partial", .. })), "{refused:?}");
}
